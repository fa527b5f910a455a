#include "io/json_text.h"

#include <algorithm>
#include <utility>

#include "io/quote.h"

namespace strata::io {
namespace {

using nlohmann::json;

// Adds up what the tree of a text takes, and stops where it is nested too deeply or, of a hostile
// text, where the tree would not fit.
class Measure : public nlohmann::json_sax<json> {
 public:
  explicit Measure(std::uint64_t limit) : limit_(limit) {}

  std::uint64_t bytes() const { return bytes_; }
  bool too_deep() const { return depth_ > kMostJsonDepth; }
  bool too_large() const { return bytes_ > limit_; }
  std::size_t error_at() const { return error_at_; }
  const std::string& error() const { return error_; }

  bool null() override { return Add(kValue); }
  bool boolean(bool) override { return Add(kValue); }
  bool number_integer(number_integer_t) override { return Add(kValue); }
  bool number_unsigned(number_unsigned_t) override { return Add(kValue); }
  bool number_float(number_float_t, const string_t&) override { return Add(kValue); }
  bool string(string_t& value) override { return Add(kValue + kBlock + value.size()); }
  bool binary(binary_t&) override { return Add(kValue); }
  bool key(string_t& value) override { return Add(kNode + value.size()); }
  bool start_object(std::size_t) override { return Enter(); }
  bool start_array(std::size_t) override { return Enter(); }
  bool end_object() override { return Leave(); }
  bool end_array() override { return Leave(); }
  bool parse_error(std::size_t at, const std::string&,
                   const nlohmann::detail::exception& e) override {
    error_at_ = at;
    error_ = e.what();
    return false;
  }

 private:
  // A value in an array that grows by doubling; what the heap adds to a block; a map's node.
  static constexpr std::uint64_t kValue = 2 * sizeof(json), kBlock = 48, kNode = 96;

  bool Add(std::uint64_t bytes) {
    bytes_ += bytes;
    return !too_large();
  }
  bool Enter() {
    ++depth_;
    return !too_deep() && Add(kValue + kBlock);
  }
  bool Leave() {
    --depth_;
    return true;
  }

  const std::uint64_t limit_;
  std::uint64_t bytes_ = 0;
  int depth_ = 0;
  std::size_t error_at_ = 0;
  std::string error_;
};

// "parse error at line 1, column 2: syntax error while …" without what the message has already.
std::string Reason(const std::string& what) {
  const std::size_t at = what.find("syntax error");
  std::string reason = at == what.npos ? what : what.substr(at);
  for (char& c : reason) c = c >= ' ' && c <= '~' ? c : '?';
  return reason.substr(0, 200);
}

}  // namespace

Result<JsonText> ParseJson(std::string_view text, const std::string& name, std::uint64_t offset,
                           MemoryAccount* memory) {
  if (text.starts_with("\xef\xbb\xbf")) {
    text.remove_prefix(3);
    offset += 3;
  }
  Measure measure(memory != nullptr ? memory->left() : MemoryAccount::kUnlimited);
  const bool sound = json::sax_parse(text.begin(), text.end(), &measure);
  if (measure.too_deep()) {
    return Fail(ErrorCode::kCorruptInput, name + ": JSON is nested deeper than " +
                                              std::to_string(kMostJsonDepth) + " levels");
  }
  JsonText parsed;
  if (memory != nullptr) {
    auto share = memory->Take(measure.bytes(), name + ": the JSON tree");
    if (!share) return Forward(share);
    parsed.share = std::move(*share);
  }
  if (!sound) {
    const std::size_t at = std::min<std::size_t>(measure.error_at(), text.size());
    return Fail(ErrorCode::kCorruptInput, name + ": byte " + std::to_string(offset + at) +
                                              ": not JSON: " + Reason(measure.error()));
  }
  parsed.root = json::parse(text.begin(), text.end(), nullptr, false);
  return parsed;
}

JsonAt JsonAt::operator[](const char* key) const {
  const std::string pointer = pointer_ + '/' + key;
  if (!present()) return {nullptr, pointer, failure_};
  if (!value_->is_object()) {
    RejectKind("an object");
    return {nullptr, pointer, failure_};
  }
  const auto found = value_->find(key);
  return {found == value_->end() ? nullptr : &*found, pointer, failure_};
}

std::size_t JsonAt::size() const {
  if (!present()) return 0;
  if (value_->is_array()) return value_->size();
  RejectKind("an array");
  return 0;
}

JsonAt JsonAt::at(std::size_t i) const {
  return {&(*value_)[i], pointer_ + '/' + std::to_string(i), failure_};
}

std::uint64_t JsonAt::Uint(std::uint64_t most) const {
  std::uint64_t number = 0;
  if (present() && value_->is_number_unsigned()) {
    number = value_->get<std::uint64_t>();
  } else if (present() && value_->is_number_float()) {
    // 3.0 is an integer, too.
    const double real = value_->get<double>();
    if (!(real >= 0 && real < 9e15 &&
          real == static_cast<double>(static_cast<std::uint64_t>(real))))
      return RejectKind("a whole number"), 0;
    number = static_cast<std::uint64_t>(real);
  } else {
    return RejectKind("a whole number"), 0;
  }
  if (number <= most) return number;
  Reject("found " + std::to_string(number) + ", expected at most " + std::to_string(most));
  return 0;
}

double JsonAt::Number() const {
  if (present() && value_->is_number()) return value_->get<double>();
  RejectKind("a number");
  return 0;
}

bool JsonAt::Bool(bool fallback) const {
  if (!present()) return fallback;
  if (value_->is_boolean()) return value_->get<bool>();
  RejectKind("true or false");
  return fallback;
}

std::string JsonAt::String() const {
  if (present() && value_->is_string()) return value_->get<std::string>();
  RejectKind("a string");
  return "";
}

std::string JsonAt::Name() const {
  return present() && value_->is_string() ? value_->get<std::string>() : "";
}

void JsonAt::RejectKind(const char* expected) const {
  const std::string found =
      present() ? Quoted(value_->dump(-1, ' ', true, json::error_handler_t::replace).substr(0, 60))
                : std::string("nothing");
  Reject("found " + found + ", expected " + expected);
}

void JsonAt::Reject(const std::string& what, ErrorCode code) const {
  if (failure_->failed) return;
  failure_->failed = true;
  const std::string where = pointer_.empty() ? "the root" : pointer_;
  failure_->error = {code, *failure_->name + ": " + where + ": " + what};
}

}  // namespace strata::io
