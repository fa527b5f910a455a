#include "io/detect_format.h"

#include <algorithm>
#include <array>

#include "core/lower_case.h"
#include "io/quote.h"
#include "io/stl_reader.h"

namespace strata::io {
namespace {

constexpr const char* kReadFormats =
    "PLY, OBJ, STL, OFF, glTF, GLB, Draco or 3MF (each also as .gz, .zst or .zip)";
constexpr std::string_view kSpace = " \t\r\n\v\f";
using namespace std::string_view_literals;

// Formats that are recognised in order to be refused by name.
struct Foreign {
  std::string_view magic;
  const char* name;
};
constexpr std::array kForeign = {
    Foreign{"BZh"sv, "bzip2 data"},
    Foreign{"\xfd"
            "7zXZ\0"sv,
            "xz data"},
    Foreign{"\x04\x22\x4d\x18"sv, "LZ4 data"},
    Foreign{"7z\xbc\xaf"sv, "a 7-Zip archive"},
    Foreign{"Rar!"sv, "a RAR archive"},
    Foreign{"\x1f\x8b"sv, "gzip data that were packed twice"},
    Foreign{"\x28\xb5\x2f\xfd"sv, "zstd data that were packed twice"},
    Foreign{"Kaydara FBX Binary"sv, "FBX"},
    Foreign{"; FBX"sv, "FBX"},
    Foreign{"BLENDER"sv, "a Blender file"},
    Foreign{"PXR-USDC"sv, "USD"},
    Foreign{"#usda"sv, "USD"},
    Foreign{"# vtk DataFile"sv, "VTK"},
    Foreign{"#VRML"sv, "VRML"},
    Foreign{"#X3D"sv, "X3D"},
    Foreign{"ISO-10303-21"sv, "STEP"},
    Foreign{"\x89HDF"sv, "HDF5"},
    Foreign{"\x89PNG"sv, "a PNG image"},
    Foreign{"\xff\xd8\xff"sv, "a JPEG image"},
    Foreign{"%PDF"sv, "PDF"},
    Foreign{"MeshVersionFormatted"sv, "MEDIT"},
    Foreign{"$MeshFormat"sv, "Gmsh"},
    Foreign{"# .PCD"sv, "PCD"},
};

// XML and JSON say what they are by a word near the front.
constexpr std::array kForeignWords = {
    Foreign{"<COLLADA"sv, "COLLADA"}, Foreign{"<VTKFile"sv, "VTK"}, Foreign{"<X3D"sv, "X3D"},
    Foreign{"<amf"sv, "AMF"},         Foreign{"<svg"sv, "SVG"},     Foreign{"<model"sv, "3MF"},
};

constexpr std::array kGltfKeys = {"\"asset\""sv, "\"meshes\""sv, "\"accessors\""sv,
                                  "\"bufferViews\""sv, "\"buffers\""sv};

constexpr std::array kObjKeywords = {
    "v"sv,         "vn"sv,     "vt"sv,     "vp"sv,     "f"sv,        "fo"sv,       "l"sv,
    "p"sv,         "o"sv,      "g"sv,      "s"sv,      "mg"sv,       "lod"sv,      "usemtl"sv,
    "mtllib"sv,    "usemap"sv, "maplib"sv, "cstype"sv, "deg"sv,      "bmat"sv,     "step"sv,
    "curv"sv,      "curv2"sv,  "surf"sv,   "parm"sv,   "trim"sv,     "hole"sv,     "scrv"sv,
    "sp"sv,        "end"sv,    "con"sv,    "bevel"sv,  "c_interp"sv, "d_interp"sv, "shadow_obj"sv,
    "trace_obj"sv, "ctech"sv,  "stech"sv,  "call"sv,   "csh"sv};

std::string_view SkipSpaceAndMark(std::string_view head) {
  if (head.starts_with("\xef\xbb\xbf")) head.remove_prefix(3);
  head.remove_prefix(std::min(head.find_first_not_of(kSpace), head.size()));
  return head;
}

// The first word that does not stand in a comment line.
std::string_view FirstWord(std::string_view text) {
  text = SkipSpaceAndMark(text);
  while (text.starts_with('#')) {
    text.remove_prefix(std::min(text.find_first_of("\r\n"), text.size()));
    text = SkipSpaceAndMark(text);
  }
  return text.substr(0, text.find_first_of(kSpace));
}

// OFF with the letters that may stand before it, in their order.
bool IsOffKeyword(std::string_view word) {
  for (const std::string_view prefix : {"ST"sv, "C"sv, "N"sv, "4"sv, "n"sv}) {
    if (word.starts_with(prefix)) word.remove_prefix(prefix.size());
  }
  return word == "OFF";
}

bool IsPly(std::string_view head) {
  const std::string_view text = SkipSpaceAndMark(head);
  return text.starts_with("ply") && (text.size() == 3 || kSpace.find(text[3]) != kSpace.npos);
}

// By a word of the format, or where the head is too short for one, by the file's suffix.
bool IsGltf(std::string_view head, std::string_view name) {
  const std::string_view text = SkipSpaceAndMark(head);
  return text.starts_with('{') &&
         (MeshSuffix(name) == "gltf" ||
          std::any_of(kGltfKeys.begin(), kGltfKeys.end(),
                      [&](std::string_view key) { return text.find(key) != text.npos; }));
}

// By the suffix, or by the name of a part that a package needs; either is read the same way.
bool Is3mf(std::string_view head, std::string_view name) {
  return MeshSuffix(name) == "3mf" || head.find("[Content_Types].xml") != head.npos ||
         head.find("3D/3dmodel.model") != head.npos;
}

const char* ForeignName(std::string_view head) {
  for (const Foreign& foreign : kForeign) {
    if (head.starts_with(foreign.magic)) return foreign.name;
  }
  if (head.size() > 262 && head.substr(257, 5) == "ustar") return "a tar archive";
  const std::string_view text = SkipSpaceAndMark(head);
  if (text.starts_with('{')) return "JSON";
  if (!text.starts_with('<')) return nullptr;
  for (const Foreign& foreign : kForeignWords) {
    if (text.find(foreign.magic) != text.npos) return foreign.name;
  }
  return "XML";
}

// What the first bytes were, in hexadecimal unless they are plain text.
std::string Describe(std::string_view head) {
  head = head.substr(0, 16);
  const bool plain =
      std::all_of(head.begin(), head.end(), [](char c) { return c >= ' ' && c <= '~'; });
  if (plain) return Quoted(head);
  std::string text = "bytes";
  constexpr const char* kDigits = "0123456789abcdef";
  for (const char c : head) {
    const auto byte = static_cast<unsigned char>(c);
    text += ' ';
    text += kDigits[byte >> 4];
    text += kDigits[byte & 15];
  }
  return text;
}

std::optional<MeshFormat> FromText(std::string_view head) {
  const std::string_view word = FirstWord(head);
  if (IsOffKeyword(word)) return MeshFormat::kOff;
  if (LowerCase(word) == "solid") return MeshFormat::kStl;
  const bool obj = std::find(kObjKeywords.begin(), kObjKeywords.end(), word) != kObjKeywords.end();
  return obj ? std::optional(MeshFormat::kObj) : std::nullopt;
}

std::optional<MeshFormat> FromSuffix(std::string_view name) {
  const std::string suffix = MeshSuffix(name);
  if (suffix == "ply") return MeshFormat::kPly;
  if (suffix == "obj") return MeshFormat::kObj;
  if (suffix == "stl") return MeshFormat::kStl;
  if (suffix == "off") return MeshFormat::kOff;
  if (suffix == "gltf") return MeshFormat::kGltf;
  if (suffix == "glb") return MeshFormat::kGlb;
  if (suffix == "drc") return MeshFormat::kDraco;
  if (suffix == "3mf") return MeshFormat::k3mf;
  return std::nullopt;
}

}  // namespace

const char* NameOf(MeshFormat format) {
  constexpr std::array kNames = {"ply", "obj", "stl", "off", "gltf", "glb", "drc", "3mf", "zip"};
  return kNames[static_cast<std::size_t>(format)];
}

std::string MeshSuffix(std::string_view name) {
  const auto take = [&name] {
    const std::size_t dot = name.find_last_of("./");
    if (dot == name.npos || name[dot] == '/') return std::string();
    std::string suffix = LowerCase(name.substr(dot + 1));
    name = name.substr(0, dot);
    return suffix;
  };
  const std::string suffix = take();
  return suffix == "gz" || suffix == "zst" || suffix == "zstd" ? take() : suffix;
}

bool HasMeshSuffix(std::string_view name) { return FromSuffix(name).has_value(); }

Result<MeshFormat> DetectFormat(const FileFacts& file) {
  if (file.head.empty()) return Fail(ErrorCode::kCorruptInput, file.name + ": the file is empty");
  if (IsPly(file.head)) return MeshFormat::kPly;
  if (HasBinaryStlSize(file.head, file.size)) return MeshFormat::kStl;
  if (file.head.starts_with("glTF")) return MeshFormat::kGlb;
  if (file.head.starts_with("PK\x03\x04") || file.head.starts_with("PK\x05\x06")) {
    return Is3mf(file.head, file.name) ? MeshFormat::k3mf : MeshFormat::kZip;
  }
  if (file.head.starts_with("DRACO")) return MeshFormat::kDraco;
  if (IsGltf(file.head, file.name)) return MeshFormat::kGltf;
  if (const char* foreign = ForeignName(file.head)) {
    return Fail(ErrorCode::kUnsupported, file.name + ": found " + foreign +
                                             ", which is not read yet; expected " + kReadFormats);
  }
  if (const auto format = FromText(file.head)) return *format;
  if (const auto format = FromSuffix(file.name)) return *format;
  if (!file.size && CouldBeBinaryStl(file.head)) return MeshFormat::kStl;
  return Fail(ErrorCode::kUnsupported, file.name + ": found a file that begins with " +
                                           Describe(file.head) + ", expected " + kReadFormats);
}

}  // namespace strata::io
