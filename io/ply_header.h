// The header of a PLY file: which elements follow, with which properties.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "io/byte_source.h"

namespace strata::io {

enum class PlyType : std::uint8_t {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kFloat32,
  kFloat64
};

/// Bytes of one value in binary files.
constexpr std::size_t PlySize(PlyType type) {
  constexpr std::size_t kSizes[] = {1, 1, 2, 2, 4, 4, 4, 8};
  return kSizes[static_cast<std::size_t>(type)];
}
constexpr bool IsInteger(PlyType type) { return type < PlyType::kFloat32; }
/// The type's name as in "uchar".
const char* PlyTypeName(PlyType type);

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kInt8;  ///< Of the value, or of a list's items.
  bool is_list = false;
  PlyType count_type = PlyType::kUint8;  ///< Of a list's length.
};

struct PlyElement {
  std::string name;
  std::uint64_t count = 0;  ///< As claimed: trust it no further than the bytes that are there.
  std::vector<PlyProperty> properties;

  /// Index of the first property of that name, or of either name if two are given.
  std::optional<std::size_t> Find(std::string_view name, std::string_view or_name = {}) const;
};

enum class PlyEncoding : std::uint8_t { kAscii, kLittleEndian, kBigEndian };
/// "ascii", "binary_little_endian", "binary_big_endian".
const char* PlyEncodingName(PlyEncoding encoding);

struct PlyHeader {
  PlyEncoding encoding = PlyEncoding::kAscii;
  std::vector<PlyElement> elements;
  std::uint64_t data_offset = 0;  ///< Of the first byte after the header.
  std::uint64_t data_line = 1;    ///< Number of the line that begins there.
  char newline = '\n';            ///< '\r' in files of the classic Mac OS.

  const PlyElement* Find(std::string_view name) const;
};

/// Reads the header at the front of `input` and consumes it. Lines may end in LF, CRLF or CR; space
/// or a byte order mark before "ply" is passed over. A line may have `max_line_bytes`, or 64 KiB if
/// that is less, the whole header 16 MiB. Unknown lines before the first element are comments.
///
/// Where the size of the source is known, counts that cannot fit it are refused here, before
/// anything is allocated for them. Errors: kCorruptInput, kUnsupported (version), kIo.
Result<PlyHeader> ReadPlyHeader(InputBuffer& input, std::size_t max_line_bytes);

}  // namespace strata::io
