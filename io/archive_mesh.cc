#include "io/archive_mesh.h"

#include <utility>
#include <vector>

#include "io/compressed_source.h"
#include "io/detect_format.h"
#include "io/quote.h"
#include "io/three_mf_reader.h"
#include "io/within_memory.h"
#include "io/zip_archive.h"

namespace strata::io {
namespace {

// Not what an archiver put beside the files for itself.
bool IsMesh(const std::string& name) {
  const std::size_t slash = name.rfind('/');
  const bool hidden = name[slash == name.npos ? 0 : slash + 1] == '.';
  return !hidden && !name.starts_with("__MACOSX/") && HasMeshSuffix(name);
}

std::string Listed(const std::vector<std::string>& names) {
  constexpr std::size_t kMost = 20;
  std::string text;
  for (std::size_t i = 0; i < names.size() && i < kMost; ++i) {
    text += (i == 0 ? "" : ", ") + Quoted(names[i]);
  }
  if (names.size() > kMost) text += ", and " + std::to_string(names.size() - kMost) + " more";
  return text.empty() ? "nothing" : text;
}

Result<std::string> Choose(const ZipArchive& archive, const std::string& wanted) {
  if (!wanted.empty()) {
    if (archive.Has(wanted)) return wanted;
    return Fail(ErrorCode::kNotFound, archive.name() + ": has no member " + Quoted(wanted) +
                                          "; it holds " + Listed(archive.names()));
  }
  std::vector<std::string> meshes;
  for (const std::string& name : archive.names()) {
    if (IsMesh(name)) meshes.push_back(name);
  }
  if (meshes.size() == 1) return meshes[0];
  if (meshes.empty()) {
    return Fail(ErrorCode::kUnsupported, archive.name() + ": found no mesh in the archive, which " +
                                             "holds " + Listed(archive.names()));
  }
  return Fail(ErrorCode::kUnsupported,
              archive.name() + ": found several meshes: " + Listed(meshes) +
                  "; name one behind a '#', as in archive.zip#inner/name.obj");
}

Result<std::unique_ptr<MeshReader>> OpenIn(std::shared_ptr<ZipArchive> archive,
                                           const OpenOptions& options, const OpenMember& open) {
  const bool package = archive->Has("[Content_Types].xml") && archive->Has("_rels/.rels");
  if (package && options.member.empty()) return OpenThreeMf(std::move(archive), options);
  auto member = Choose(*archive, options.member);
  if (!member) return Forward(member);
  auto stored = archive->Extract(*member);
  if (!stored) return Forward(stored);
  const std::size_t slash = member->rfind('/');
  OpenOptions inside = options;
  inside.member.clear();
  inside.companions =
      FilesInArchive(std::move(archive), slash == member->npos ? "" : member->substr(0, slash));
  auto unpacked = Unpack(std::move(*stored));
  if (!unpacked) return Forward(unpacked);
  return open(std::move(*unpacked), inside);
}

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenArchive(std::unique_ptr<ByteSource> source,
                                                const OpenOptions& options,
                                                const OpenMember& open) {
  using Opened = Result<std::unique_ptr<MeshReader>>;
  return WithinMemory(
      source->name() + ": out of memory while opening the archive", [&]() -> Opened {
        auto readable = WithReadAt(std::move(source), options.scratch);
        if (!readable) return Forward(readable);
        auto archive = ZipArchive::Open(std::move(*readable), options.scratch, options.context);
        if (!archive) return Forward(archive);
        return OpenIn(std::move(*archive), options, open);
      });
}

}  // namespace strata::io
