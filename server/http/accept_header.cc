#include "server/http/accept_header.h"

#include <algorithm>
#include <charconv>

#include "core/lower_case.h"
#include "server/service/wire_options.h"

namespace strata::server {
namespace {

std::string_view Trim(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

/// Takes the part of `text` before `mark` off its front.
std::string_view Cut(std::string_view& text, char mark) {
  const std::size_t end = std::min(text.find(mark), text.size());
  const std::string_view part = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  return Trim(part);
}

/// 3: the type itself, 2: "model/*", 1: "*/*", 0: does not fit.
int Fit(const std::string& range, std::string_view type) {
  if (range == type) return 3;
  const std::string_view group = type.substr(0, type.find('/') + 1);
  if (range.ends_with("/*") && range.substr(0, range.size() - 1) == group) return 2;
  // Bytes of any kind: what a client that only saves them asks for.
  if (range == "*/*" || range == "application/octet-stream") return 1;
  return 0;
}

double WeightOf(std::string_view parameters) {
  while (!parameters.empty()) {
    const std::string_view parameter = Cut(parameters, ';');
    if (!parameter.starts_with("q=") && !parameter.starts_with("Q=")) continue;
    double weight = 0;
    const auto parsed =
        std::from_chars(parameter.data() + 2, parameter.data() + parameter.size(), weight);
    return parsed.ec == std::errc() ? std::clamp(weight, 0.0, 1.0) : 0;
  }
  return 1;
}

/// The weight that `accept` gives to `type`: that of the range that fits it best.
double WeightFor(std::string_view accept, std::string_view type) {
  int best = 0;
  double weight = 0;
  while (!accept.empty()) {
    std::string_view entry = Cut(accept, ',');
    const std::string range = LowerCase(Cut(entry, ';'));
    const int fit = Fit(range, type);
    if (fit <= best) continue;
    best = fit;
    weight = WeightOf(entry);
  }
  return weight;
}

}  // namespace

Answer<std::string> FormatForAccept(std::string_view accept) {
  if (Trim(accept).empty()) return std::string(Formats().front().name);
  const FormatName* chosen = nullptr;
  double best = 0;
  std::string known;
  for (const FormatName& format : Formats()) {
    const double weight = WeightFor(accept, format.media_type);
    if (weight > best) chosen = &format;
    best = std::max(best, weight);
    known += (known.empty() ? "" : ", ") + std::string(format.media_type);
  }
  if (!chosen) {
    return Refuse(Refusal::kNotAcceptable,
                  "Accept: found '" + std::string(accept) + "', expected one of " + known);
  }
  return std::string(chosen->name);
}

}  // namespace strata::server
