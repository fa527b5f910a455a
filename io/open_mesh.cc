#include "io/open_mesh.h"

#include <unistd.h>

#include <algorithm>
#include <new>
#include <string>
#include <utility>

#include "io/archive_mesh.h"
#include "io/assimp_reader.h"
#include "io/byte_source.h"
#include "io/companion_file.h"
#include "io/detect_format.h"
#include "io/drc_reader.h"
#include "io/gltf_reader.h"
#include "io/obj_reader.h"
#include "io/off_reader.h"
#include "io/ply_reader.h"
#include "io/stl_reader.h"

namespace strata::io {
namespace {

// Leaves the source at byte 0.
Result<MeshFormat> Detect(ByteSource& source) {
  InputBuffer look(source, kDetectBytes);
  auto head = look.Peek(kDetectBytes);
  if (!head) return Forward(head);
  FileFacts facts{*head, source.size(), source.name()};
  if (head->size() < kDetectBytes) facts.size = head->size();
  auto format = DetectFormat(facts);
  if (auto ok = source.Seek(0); !ok) return Forward(ok);
  return format;
}

Result<std::unique_ptr<MeshReader>> OpenPlain(std::unique_ptr<ByteSource> source,
                                              const OpenOptions& options);

// A format that is not ours, and somebody who may know it.
bool MayAsk(const Error& error, const OpenOptions& options) {
  return error.code == ErrorCode::kUnsupported && !options.assimp.empty();
}

Result<std::unique_ptr<MeshReader>> OpenAs(MeshFormat format, std::unique_ptr<ByteSource> source,
                                           const OpenOptions& options) {
  switch (format) {
    case MeshFormat::kPly:
      return OpenPly(std::move(source), options);
    case MeshFormat::kObj:
      return OpenObj(std::move(source), options);
    case MeshFormat::kStl:
      return OpenStl(std::move(source), options);
    case MeshFormat::kOff:
      return OpenOff(std::move(source), options);
    case MeshFormat::kGltf:
    case MeshFormat::kGlb:
      return OpenGltf(std::move(source), options);
    case MeshFormat::kDraco:
      return OpenDraco(std::move(source), options);
    case MeshFormat::k3mf:
    case MeshFormat::kZip:
      return OpenArchive(std::move(source), options, OpenPlain);
  }
  return Fail(ErrorCode::kInternal, source->name() + ": a format without a reader");
}

// What is no archive: there are none in archives.
Result<std::unique_ptr<MeshReader>> OpenPlain(std::unique_ptr<ByteSource> source,
                                              const OpenOptions& options) {
  const auto format = Detect(*source);
  if (!format && MayAsk(format.error(), options)) return OpenAssimp(std::move(source), options);
  if (!format) return Forward(format);
  if (*format == MeshFormat::kZip || *format == MeshFormat::k3mf) {
    return Fail(ErrorCode::kUnsupported, source->name() + ": found an archive in an archive");
  }
  return OpenAs(*format, std::move(source), options);
}

// Where files that the mesh names may lie; nowhere for what has no place of its own.
std::shared_ptr<const CompanionFiles> CompanionsOf(const std::string& path) {
  if (path == "-" || path.starts_with("/dev/") || path.starts_with("/proc/")) return nullptr;
  const std::size_t slash = path.rfind('/');
  if (slash == path.npos) return FilesInFolder(".");
  return FilesInFolder(path.substr(0, std::max<std::size_t>(slash, 1)));
}

}  // namespace

std::pair<std::string, std::string> SplitMember(const std::string& path) {
  for (std::size_t at = path.find('#'); at != path.npos; at = path.find('#', at + 1)) {
    const std::string archive = path.substr(0, at);
    const std::string suffix = MeshSuffix(archive);
    if ((suffix == "zip" || suffix == "3mf") && ::access(path.c_str(), F_OK) != 0) {
      return {archive, path.substr(at + 1)};
    }
  }
  return {path, ""};
}

Result<std::unique_ptr<MeshReader>> OpenMesh(std::unique_ptr<ByteSource> source,
                                             const OpenOptions& options) {
  auto format = Detect(*source);
  if (!format && MayAsk(format.error(), options)) return OpenAssimp(std::move(source), options);
  if (!format) return Forward(format);
  if (!options.member.empty() && *format != MeshFormat::kZip && *format != MeshFormat::k3mf) {
    return Fail(ErrorCode::kUnsupported, source->name() + ": found " + NameOf(*format) +
                                             ", which has no members; expected a ZIP archive");
  }
  return OpenAs(*format, std::move(source), options);
}

Result<std::unique_ptr<MeshReader>> OpenMesh(const std::string& path, const OpenOptions& options) {
  try {
    auto [file, member] = SplitMember(path);
    auto source = OpenByteSource(file, options.scratch);
    if (!source) return Forward(source);
    OpenOptions with_folder = options;
    if (!member.empty()) with_folder.member = std::move(member);
    if (options.companions == nullptr) with_folder.companions = CompanionsOf(path);
    return OpenMesh(std::move(*source), with_folder);
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, path + ": out of memory while opening it");
  }
}

}  // namespace strata::io
