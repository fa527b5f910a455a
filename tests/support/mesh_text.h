// Small meshes as the bytes of a file, in each encoding.
#pragma once

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

namespace strata::test {

/// One element of a PLY file: its properties as in the header ("float x", "list uchar int
/// vertex_indices"), its rows as plain numbers (a list as its length and then its items).
struct PlyPart {
  std::string name;
  std::vector<std::string> properties;
  std::vector<std::vector<double>> rows;
};

/// The three formats of the header.
inline constexpr const char* kPlyFormats[] = {"ascii", "binary_little_endian", "binary_big_endian"};

/// Appends the bytes of `value`, in the order of a big-endian machine if `big`.
template <class T>
void AppendBytes(T value, bool big, std::string& out) {
  const char* const bytes = reinterpret_cast<const char*>(&value);
  if (big) {
    out.append(std::reverse_iterator(bytes + sizeof(T)), std::reverse_iterator(bytes));
  } else {
    out.append(bytes, sizeof(T));
  }
}

/// Appends `value` as a PLY type, which may go by its old or new name.
inline void AppendPlyValue(std::string_view type, double value, bool big, std::string& out) {
  if (type == "char" || type == "int8") return AppendBytes<std::int8_t>(value, big, out);
  if (type == "uchar" || type == "uint8") return AppendBytes<std::uint8_t>(value, big, out);
  if (type == "short" || type == "int16") return AppendBytes<std::int16_t>(value, big, out);
  if (type == "ushort" || type == "uint16") return AppendBytes<std::uint16_t>(value, big, out);
  if (type == "int" || type == "int32") return AppendBytes<std::int32_t>(value, big, out);
  if (type == "uint" || type == "uint32") return AppendBytes<std::uint32_t>(value, big, out);
  if (type == "float" || type == "float32") return AppendBytes<float>(value, big, out);
  AppendBytes<double>(value, big, out);
}

inline void AppendPlyRow(const PlyPart& part, const std::vector<double>& row, bool big,
                         std::string& out) {
  auto value = row.begin();
  for (const std::string& property : part.properties) {
    std::istringstream words(property);
    std::string type;
    words >> type;
    std::size_t n = 1;
    if (type == "list") {
      words >> type;
      n = static_cast<std::size_t>(*value);
      AppendPlyValue(type, *value++, big, out);
      words >> type;
    }
    while (n-- > 0) AppendPlyValue(type, *value++, big, out);
  }
}

/// The header alone.
inline std::string PlyHeaderText(const std::string& format, const std::vector<PlyPart>& parts,
                                 const std::string& newline = "\n") {
  std::string out =
      "ply" + newline + "format " + format + " 1.0" + newline + "comment a test" + newline;
  for (const PlyPart& part : parts) {
    out += "element " + part.name + " " + std::to_string(part.rows.size()) + newline;
    for (const std::string& p : part.properties) out += "property " + p + newline;
  }
  return out + "obj_info none" + newline + "end_header" + newline;
}

/// A whole PLY file. Numbers in ascii have 9 digits, enough for any float.
inline std::string MakePly(const std::string& format, const std::vector<PlyPart>& parts,
                           const std::string& newline = "\n") {
  std::string out = PlyHeaderText(format, parts, newline);
  for (const PlyPart& part : parts) {
    for (const auto& row : part.rows) {
      if (format != "ascii") {
        AppendPlyRow(part, row, format == "binary_big_endian", out);
        continue;
      }
      std::ostringstream line;
      line.precision(9);
      for (std::size_t i = 0; i < row.size(); ++i) line << (i > 0 ? " " : "") << row[i];
      out += line.str() + newline;
    }
  }
  return out;
}

/// Vertices with float x, y, z.
inline PlyPart PlyVertices(std::vector<std::vector<double>> rows) {
  return {"vertex", {"float x", "float y", "float z"}, std::move(rows)};
}
/// Faces given by their corners.
inline PlyPart PlyFaces(std::vector<std::vector<double>> corners) {
  for (auto& row : corners) row.insert(row.begin(), static_cast<double>(row.size()));
  return {"face", {"list uchar int vertex_indices"}, std::move(corners)};
}

/// A triangle as nine numbers.
using NineFloats = std::vector<float>;

inline std::string MakeAsciiStl(const std::vector<NineFloats>& facets,
                                const std::string& name = "a solid") {
  std::ostringstream out;
  out.precision(9);
  out << "solid " << name << "\n";
  for (const NineFloats& f : facets) {
    out << "  facet normal 0 0 1\n    outer loop\n";
    for (std::size_t v = 0; v < 9; v += 3) {
      out << "      vertex " << f[v] << " " << f[v + 1] << " " << f[v + 2] << "\n";
    }
    out << "    endloop\n  endfacet\n";
  }
  out << "endsolid " << name << "\n";
  return out.str();
}

/// `header` is filled up to its 80 bytes.
inline std::string MakeBinaryStl(const std::vector<NineFloats>& facets,
                                 std::string header = "binary") {
  header.resize(80);
  std::string out = header;
  AppendBytes(static_cast<std::uint32_t>(facets.size()), false, out);
  for (const NineFloats& f : facets) {
    for (const float normal : {0.0f, 0.0f, 1.0f}) AppendBytes(normal, false, out);
    for (const float value : f) AppendBytes(value, false, out);
    AppendBytes(std::uint16_t{0}, false, out);
  }
  return out;
}

}  // namespace strata::test
