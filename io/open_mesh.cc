#include "io/open_mesh.h"

#include <new>
#include <utility>

#include "io/byte_source.h"
#include "io/detect_format.h"
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
  }
  return Fail(ErrorCode::kInternal, source->name() + ": a format without a reader");
}

}  // namespace

Result<std::unique_ptr<MeshReader>> OpenMesh(std::unique_ptr<ByteSource> source,
                                             const OpenOptions& options) {
  auto format = Detect(*source);
  if (!format) return Forward(format);
  return OpenAs(*format, std::move(source), options);
}

Result<std::unique_ptr<MeshReader>> OpenMesh(const std::string& path, const OpenOptions& options) {
  try {
    auto source = OpenByteSource(path, options.scratch);
    if (!source) return Forward(source);
    return OpenMesh(std::move(*source), options);
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, path + ": out of memory while opening it");
  }
}

}  // namespace strata::io
