#include "server/batch/plots.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <vector>

#include "server/human_units.h"

namespace strata::server {
namespace {

constexpr double kWidth = 480, kHeight = 280, kLeft = 56, kRight = 26, kTop = 26, kBottom = 40;

/// Powers of ten around positive values; at least one decade.
struct LogRange {
  double low = 0, high = 1;  // Exponents, whole.
  double Share(double value) const { return (std::log10(value) - low) / (high - low); }
};

LogRange RangeOf(std::span<const double> values) {
  double least = std::numeric_limits<double>::infinity(), most = 0;
  for (const double value : values) {
    if (!(value > 0) || !std::isfinite(value)) continue;
    least = std::min(least, value);
    most = std::max(most, value);
  }
  if (most == 0) return {};
  LogRange range = {std::floor(std::log10(least)), std::ceil(std::log10(most))};
  if (range.high <= range.low) range.high = range.low + 1;
  return range;
}

double X(double share) { return kLeft + share * (kWidth - kLeft - kRight); }
double Y(double share) { return kHeight - kBottom - share * (kHeight - kTop - kBottom); }

void Begin(std::ostream& out) {
  out.precision(5);
  out << "<svg viewBox=\"0 0 " << kWidth << ' ' << kHeight << "\" role=\"img\">";
}

void XAxis(std::ostream& out, const LogRange& range, std::string_view name) {
  const double step = std::max(1.0, std::ceil((range.high - range.low) / 8));
  for (double at = range.low; at <= range.high; at += step) {
    const double x = X((at - range.low) / (range.high - range.low));
    out << "<line class=\"grid\" x1=\"" << x << "\" x2=\"" << x << "\" y1=\"" << kTop << "\" y2=\""
        << Y(0) << "\"/><text text-anchor=\"middle\" x=\"" << x << "\" y=\"" << Y(0) + 15 << "\">"
        << Short(std::pow(10, at), 3) << "</text>";
  }
  out << "<line class=\"axis\" x1=\"" << kLeft << "\" x2=\"" << kWidth - kRight << "\" y1=\""
      << Y(0) << "\" y2=\"" << Y(0) << "\"/><text text-anchor=\"middle\" x=\"" << X(0.5)
      << "\" y=\"" << kHeight - 6 << "\">" << name << "</text>";
}

void YLabel(std::ostream& out, double share, const std::string& text) {
  out << "<line class=\"grid\" x1=\"" << kLeft << "\" x2=\"" << kWidth - kRight << "\" y1=\""
      << Y(share) << "\" y2=\"" << Y(share) << "\"/><text text-anchor=\"end\" x=\"" << kLeft - 6
      << "\" y=\"" << Y(share) + 4 << "\">" << text << "</text>";
}

}  // namespace

std::string HistogramSvg(std::span<const double> values, std::string_view axis) {
  constexpr std::size_t kBinsPerDecade = 6;
  const LogRange range = RangeOf(values);
  const auto bins = static_cast<std::size_t>(range.high - range.low) * kBinsPerDecade;
  std::vector<std::size_t> counts(bins, 0);
  for (const double value : values) {
    const double share = value > 0 ? range.Share(value) : 0;
    ++counts[std::min(static_cast<std::size_t>(share * static_cast<double>(bins)), bins - 1)];
  }
  const std::size_t most = std::max<std::size_t>(1, *std::ranges::max_element(counts));
  std::ostringstream out;
  Begin(out);
  YLabel(out, 0, "0");
  YLabel(out, 1, Grouped(most));
  XAxis(out, range, axis);
  for (std::size_t i = 0; i < bins; ++i) {
    if (counts[i] == 0) continue;
    const double left = X(static_cast<double>(i) / static_cast<double>(bins));
    const double right = X(static_cast<double>(i + 1) / static_cast<double>(bins));
    const double top = Y(static_cast<double>(counts[i]) / static_cast<double>(most));
    out << "<rect class=\"mark\" x=\"" << left + 0.5 << "\" width=\""
        << std::max(0.5, right - left - 1) << "\" y=\"" << top << "\" height=\"" << Y(0) - top
        << "\"><title>" << Grouped(counts[i]) << "</title></rect>";
  }
  out << "</svg>";
  return out.str();
}

std::string ScatterSvg(std::span<const PlotPoint> points, std::string_view x_axis,
                       std::string_view y_axis) {
  std::vector<double> xs, ys;
  for (const PlotPoint& point : points) {
    xs.push_back(point.x);
    ys.push_back(point.y);
  }
  const LogRange x_range = RangeOf(xs), y_range = RangeOf(ys);
  std::ostringstream out;
  Begin(out);
  for (double at = y_range.low; at <= y_range.high; ++at) {
    YLabel(out, (at - y_range.low) / (y_range.high - y_range.low), Si(std::pow(10, at)));
  }
  XAxis(out, x_range, x_axis);
  out << "<text x=\"4\" y=\"14\">" << y_axis << "</text>";
  for (const PlotPoint& point : points) {
    if (!(point.x > 0) || !(point.y > 0)) continue;
    out << "<circle class=\"mark\" fill-opacity=\"0.6\" r=\"3\" cx=\"" << X(x_range.Share(point.x))
        << "\" cy=\"" << Y(y_range.Share(point.y)) << "\"><title>" << point.title
        << "</title></circle>";
  }
  out << "</svg>";
  return out.str();
}

}  // namespace strata::server
