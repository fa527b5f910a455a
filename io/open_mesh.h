// Opening a mesh file of any supported format.
#pragma once

#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "core/memory_account.h"
#include "core/mesh_reader.h"
#include "core/run_context.h"
#include "core/scratch.h"

namespace strata::io {

class ByteSource;
class CompanionFiles;

struct OpenOptions {
  /// Bytes a single text line may have before the file is refused as corrupt.
  std::size_t max_line_bytes = std::size_t{1} << 20;
  /// What the vertices take is taken from here, if it is given.
  MemoryAccount* memory = nullptr;
  /// Bytes that vertices may occupy, or what is left of `memory` if that is less. Vertices beyond
  /// stay on disk (docs/adr/0008); 1 MiB is enough for 10^9 of them, if slow.
  std::uint64_t vertex_budget = std::numeric_limits<std::uint64_t>::max();
  /// Where vertices that exceed the budget go. Without it only those of binary PLY can exceed it,
  /// slowly if their indices are not coherent; others are kOverBudget.
  ScratchFolder* scratch = nullptr;
  /// Where files are that the mesh names: glTF buffers, textures. Null: nowhere, and a mesh that
  /// needs one is kUnsupported. OpenMesh with a path sets it to the path's folder (not for /dev and
  /// /proc), of a mesh in an archive to the archive.
  std::shared_ptr<const CompanionFiles> companions;
  /// Of an archive: the member to open. "": its only mesh.
  std::string member;
  /// The program strata-assimp, which reads formats that Strata does not. "": such are refused.
  std::string assimp;
  /// A Read that has to look far ahead polls its cancel flag and fails with kCancelled.
  const RunContext* context = nullptr;
};

/// Opens `path` ("-" is standard input, which is copied to scratch space), tells the format
/// from its content (the suffix only breaks ties), unpacks gzip and zstd on the fly, reads the
/// vertices of indexed formats, and stops before the first triangle.
///
/// What `options` points at must outlive the reader.
/// Formats: PLY (ascii, binary of both endians), OBJ, STL (ascii, binary), OFF family (ascii), glTF
/// 2.0 (text and GLB), Draco meshes, 3MF; each
/// also as the only mesh of a ZIP archive, or as the one named behind a '#': "a.zip#b/c.obj".
/// docs/mesh-formats.md says what is read of each. Errors: kNotFound, kIo, kUnsupported,
/// kCorruptInput, kOverBudget; the message names the file, or the scratch folder if that is what
/// failed.
Result<std::unique_ptr<MeshReader>> OpenMesh(const std::string& path,
                                             const OpenOptions& options = {});

/// "a.zip#b" as the path of an archive and its member; the whole as a path if there is such a file,
/// or no '#' behind ".zip" or ".3mf".
std::pair<std::string, std::string> SplitMember(const std::string& path);

/// The same from bytes that are at hand; `source` stands at its first byte.
Result<std::unique_ptr<MeshReader>> OpenMesh(std::unique_ptr<ByteSource> source,
                                             const OpenOptions& options = {});

}  // namespace strata::io
