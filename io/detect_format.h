// Telling mesh formats apart.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "core/result.h"

namespace strata::io {

enum class MeshFormat : std::uint8_t { kPly, kObj, kStl, kOff, kGltf, kGlb, kDraco, k3mf, kZip };

/// "ply", "obj", …: MeshInfo::format.
const char* NameOf(MeshFormat format);

/// What can be known of a file before reading it.
struct FileFacts {
  std::string_view head;              ///< The first kDetectBytes of the unpacked stream, or all.
  std::optional<std::uint64_t> size;  ///< Of the unpacked stream, if known.
  std::string name;                   ///< As given by the user: messages, and the suffix.
};
inline constexpr std::size_t kDetectBytes = std::size_t{1} << 14;

/// The suffix of a file name in lower case without its dot, "" if none. ".gz", ".zst" and ".zstd"
/// are passed over: "a/Model.PLY.gz" gives "ply".
std::string MeshSuffix(std::string_view name);

/// Whether files of this name are usually meshes of a format that Strata reads, packed ones too.
bool HasMeshSuffix(std::string_view name);

/// Tells the format from the content. The suffix decides only where the content leaves it open: OFF
/// without its keyword, text that begins with nothing but comments, and files of no known form,
/// whose reader will then say what is wrong with them.
///
/// Errors: kUnsupported for known formats that are not read (by name: glTF, Draco, ZIP, …) and for
/// what is not recognised; kCorruptInput for an empty file.
Result<MeshFormat> DetectFormat(const FileFacts& file);

}  // namespace strata::io
