#include "io/ply_header.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <utility>

#include "io/quote.h"

namespace strata::io {
namespace {

constexpr std::size_t kMaxLineBytes = std::size_t{1} << 16;
constexpr std::uint64_t kMaxHeaderBytes = std::uint64_t{1} << 24;
constexpr std::size_t kMaxElements = 1024;

struct TypeName {
  std::string_view name;
  PlyType type;
};
constexpr std::array kTypeNames = {
    TypeName{"char", PlyType::kInt8},       TypeName{"uchar", PlyType::kUint8},
    TypeName{"short", PlyType::kInt16},     TypeName{"ushort", PlyType::kUint16},
    TypeName{"int", PlyType::kInt32},       TypeName{"uint", PlyType::kUint32},
    TypeName{"float", PlyType::kFloat32},   TypeName{"double", PlyType::kFloat64},
    TypeName{"int8", PlyType::kInt8},       TypeName{"uint8", PlyType::kUint8},
    TypeName{"int16", PlyType::kInt16},     TypeName{"uint16", PlyType::kUint16},
    TypeName{"int32", PlyType::kInt32},     TypeName{"uint32", PlyType::kUint32},
    TypeName{"float32", PlyType::kFloat32}, TypeName{"float64", PlyType::kFloat64}};

// Splits off the next word.
std::string_view TakeWord(std::string_view& line) {
  const std::size_t begin = std::min(line.find_first_not_of(" \t\r"), line.size());
  const std::size_t end = std::min(line.find_first_of(" \t\r", begin), line.size());
  const std::string_view word = line.substr(begin, end - begin);
  line.remove_prefix(end);
  return word;
}

// A word of the header for a message.
std::string Found(std::string_view word) {
  return word.empty() ? "the end of the line" : Quoted(word);
}

class HeaderParser {
 public:
  HeaderParser(InputBuffer& input, std::size_t max_line_bytes)
      : input_(input), max_line_bytes_(std::min(max_line_bytes, kMaxLineBytes)) {}

  Result<PlyHeader> Parse() {
    if (auto ok = ReadMagic(); !ok) return Forward(ok);
    for (bool done = false; !done;) {
      auto line = ReadLine();
      if (!line) return Forward(line);
      auto ended = ParseLine(*line);
      if (!ended) return Forward(ended);
      done = *ended;
    }
    if (!seen_format_) return Wrong("found end_header, expected a 'format' line before it");
    header_.data_offset = input_.offset();
    header_.data_line = line_ + 1;
    return std::move(header_);
  }

 private:
  tl::unexpected<Error> Wrong(const std::string& what,
                              ErrorCode code = ErrorCode::kCorruptInput) const {
    return Fail(code, input_.source().name() + ": line " + std::to_string(line_) + ": " + what);
  }

  // "ply" and its line end, which tells how all lines end.
  Result<void> ReadMagic() {
    auto window = input_.Peek(3);
    if (!window) return Forward(window);
    if (window->starts_with("\xef\xbb\xbf")) input_.Consume(3);
    for (std::uint64_t passed = 0;; ++passed) {
      window = input_.Peek(5);
      if (!window) return Forward(window);
      if (window->empty() || passed == max_line_bytes_) break;
      const char c = window->front();
      if (c != ' ' && c != '\t' && c != '\n' && c != '\r') break;
      line_ += c == '\n';
      input_.Consume(1);
    }
    ++line_;
    if (!window->starts_with("ply")) {
      return Wrong("found " + Found(window->substr(0, 3)) + ", expected 'ply'");
    }
    if (window->substr(3, 1) == "\r" && window->substr(4, 1) != "\n") header_.newline = '\r';
    --line_;  // Counted again with the rest of the line.
    auto rest = ReadLine();
    if (!rest) return Forward(rest);
    std::string_view words = *rest;
    if (TakeWord(words) != "ply" || !TakeWord(words).empty()) {
      return Wrong("found " + Found(*rest) + ", expected 'ply' alone");
    }
    return {};
  }

  // The next line without its end; valid until the next call.
  Result<std::string_view> ReadLine() {
    ++line_;
    for (std::size_t want = 256;; want *= 2) {
      auto window = input_.Peek(std::min(want, max_line_bytes_ + 1));
      if (!window) return window;
      const std::size_t length = window->find(header_.newline);
      if (length <= max_line_bytes_) {
        input_.Consume(length + 1);
        if (input_.offset() > kMaxHeaderBytes) {
          return Wrong("the header is longer than 16 MiB, expected end_header");
        }
        return window->substr(0, length);
      }
      if (window->size() > max_line_bytes_) {
        return Wrong("found a line of more than " + std::to_string(max_line_bytes_) + " bytes");
      }
      // A file that ends with "end_header" and nothing behind it lacks only the line's end.
      if (window->size() < want) return LastLine(*window);
    }
  }

  Result<std::string_view> LastLine(std::string_view line) {
    std::string_view words = line;
    if (TakeWord(words) != "end_header") {
      return Wrong("the file ends inside the header, expected end_header");
    }
    input_.Consume(line.size());
    return line;
  }

  // True at end_header.
  Result<bool> ParseLine(std::string_view line) {
    const std::string_view keyword = TakeWord(line);
    Result<void> ok;
    if (keyword == "end_header") {
      if (const auto extra = TakeWord(line); !extra.empty()) {
        return Wrong("found " + Found(extra) + " after end_header, expected the end of the line");
      }
      return true;
    }
    if (keyword == "format") {
      ok = ParseFormat(line);
    } else if (keyword == "element") {
      ok = ParseElement(line);
    } else if (keyword == "property") {
      ok = ParseProperty(line);
    } else if (!keyword.empty() && keyword != "comment" && keyword != "obj_info" &&
               !header_.elements.empty()) {
      // Before the first element Blender 2.4 wrote a comment without that word; nothing that counts
      // can be meant there.
      return Wrong("found " + Found(keyword) +
                   ", expected comment, obj_info, element, property or end_header");
    }
    if (!ok) return Forward(ok);
    return false;
  }

  Result<void> ParseFormat(std::string_view words) {
    if (seen_format_) return Wrong("found a second 'format' line");
    const std::string_view encoding = TakeWord(words), version = TakeWord(words);
    constexpr std::array kEncodings = {PlyEncoding::kAscii, PlyEncoding::kLittleEndian,
                                       PlyEncoding::kBigEndian};
    const auto* const found =
        std::find_if(kEncodings.begin(), kEncodings.end(),
                     [&](PlyEncoding e) { return encoding == PlyEncodingName(e); });
    if (found == kEncodings.end()) {
      return Wrong("found format " + Found(encoding) +
                   ", expected ascii, binary_little_endian or binary_big_endian");
    }
    if (version != "1.0") {
      return Wrong("found version " + Found(version) + ", expected 1.0", ErrorCode::kUnsupported);
    }
    header_.encoding = *found;
    seen_format_ = true;
    return {};
  }

  Result<void> ParseElement(std::string_view words) {
    const std::string_view name = TakeWord(words), count = TakeWord(words);
    if (name.empty()) return Wrong("found 'element' without a name");
    PlyElement element{std::string(name), 0, {}};
    const char* const end = count.data() + count.size();
    const auto [stop, error] = std::from_chars(count.data(), end, element.count);
    if (error != std::errc{} || stop != end) {
      return Wrong("found " + Found(count) + ", expected the number of '" + element.name + "'");
    }
    if (header_.elements.size() == kMaxElements) {
      return Wrong("found more than " + std::to_string(kMaxElements) + " elements",
                   ErrorCode::kUnsupported);
    }
    if (header_.Find(name) != nullptr) return Wrong("found a second element " + Quoted(name));
    header_.elements.push_back(std::move(element));
    return {};
  }

  Result<void> ParseProperty(std::string_view words) {
    if (header_.elements.empty()) return Wrong("found 'property' before the first 'element'");
    PlyProperty property;
    std::string_view type = TakeWord(words);
    property.is_list = type == "list";
    if (property.is_list) {
      if (auto ok = ParseType(TakeWord(words), property.count_type); !ok) return ok;
      if (!IsInteger(property.count_type)) {
        return Wrong("found a list length of a floating-point type, expected an integer type");
      }
      type = TakeWord(words);
    }
    if (auto ok = ParseType(type, property.type); !ok) return ok;
    property.name = TakeWord(words);
    if (property.name.empty()) return Wrong("found 'property' without a name");
    header_.elements.back().properties.push_back(std::move(property));
    return {};
  }

  Result<void> ParseType(std::string_view word, PlyType& type) const {
    for (const TypeName& known : kTypeNames) {
      if (known.name == word) {
        type = known.type;
        return {};
      }
    }
    return Wrong("found type " + Found(word) + ", expected one like float, int32 or uchar");
  }

  InputBuffer& input_;
  std::size_t max_line_bytes_;
  PlyHeader header_;
  std::uint64_t line_ = 0;
  bool seen_format_ = false;
};

// The least that a row can take up. In ascii a value and what separates it from the next.
std::uint64_t LeastRowBytes(const PlyElement& element, PlyEncoding encoding) {
  std::uint64_t bytes = 0;
  for (const PlyProperty& p : element.properties) {
    if (encoding == PlyEncoding::kAscii) {
      bytes += 2;
    } else {
      bytes += PlySize(p.is_list ? p.count_type : p.type);
    }
  }
  return bytes;
}

Result<void> CheckAgainstSize(const PlyHeader& header, const ByteSource& source) {
  const auto size = source.size();
  if (!size) return {};
  std::uint64_t left = *size > header.data_offset ? *size - header.data_offset : 0;
  const std::uint64_t all = left;
  // The last value of an ascii file needs nothing behind it.
  if (header.encoding == PlyEncoding::kAscii) ++left;
  for (const PlyElement& element : header.elements) {
    const std::uint64_t row = LeastRowBytes(element, header.encoding);
    if (row > 0 && element.count > left / row) {
      return Fail(ErrorCode::kCorruptInput,
                  source.name() + ": byte " + std::to_string(header.data_offset) + ": found " +
                      std::to_string(all) + " bytes of data, expected at least " +
                      std::to_string(row) + " for each of " + std::to_string(element.count) + " '" +
                      element.name + "' after what comes before them");
    }
    left -= element.count * row;
  }
  return {};
}

}  // namespace

const char* PlyTypeName(PlyType type) {
  return kTypeNames[static_cast<std::size_t>(type)].name.data();
}

const char* PlyEncodingName(PlyEncoding encoding) {
  constexpr const char* kNames[] = {"ascii", "binary_little_endian", "binary_big_endian"};
  return kNames[static_cast<std::size_t>(encoding)];
}

std::optional<std::size_t> PlyElement::Find(std::string_view wanted,
                                            std::string_view or_name) const {
  for (std::size_t i = 0; i < properties.size(); ++i) {
    const std::string& found = properties[i].name;
    if (found == wanted || (!or_name.empty() && found == or_name)) return i;
  }
  return std::nullopt;
}

const PlyElement* PlyHeader::Find(std::string_view name) const {
  const auto found = std::find_if(elements.begin(), elements.end(),
                                  [&](const PlyElement& e) { return e.name == name; });
  return found == elements.end() ? nullptr : &*found;
}

Result<PlyHeader> ReadPlyHeader(InputBuffer& input, std::size_t max_line_bytes) {
  auto header = HeaderParser(input, max_line_bytes).Parse();
  if (!header) return header;
  if (auto ok = CheckAgainstSize(*header, input.source()); !ok) return Forward(ok);
  return header;
}

}  // namespace strata::io
