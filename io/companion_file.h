// Files that a mesh names: buffers, materials, textures.
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "core/scratch.h"
#include "io/byte_source.h"

namespace strata::io {

/// The path that a URI reference of a file names, percent escapes resolved. Only a relative path to
/// a file below the folder is one: no scheme, no host, no root, no "..", no NUL, no backslash.
/// Errors: kUnsupported, with `who` (file and place) in front.
Result<std::string> RelativePath(const std::string& uri, const std::string& who);
/// The same of a plain path, as OBJ has them: no percent escapes; backslashes are slashes.
Result<std::string> RelativePathOfName(const std::string& name, const std::string& who);

/// Where such paths lead: a folder, or the archive that the mesh came from. Threads: one at a time.
class CompanionFiles {
 public:
  virtual ~CompanionFiles() = default;
  /// Opens `relative`, the outcome of one of the above, as it is stored. Errors, with `who` in
  /// front: kNotFound; kUnsupported for what is no regular file or leads out; kIo.
  virtual Result<std::unique_ptr<ByteSource>> Open(const std::string& relative,
                                                   const std::string& who) const = 0;
};

/// Files in `folder` and below. Symbolic links are followed as long as they stay there.
std::shared_ptr<const CompanionFiles> FilesInFolder(std::string folder);

/// Opens `relative` in OpenOptions::companions; without any that is kUnsupported.
Result<std::unique_ptr<ByteSource>> OpenCompanion(
    const std::shared_ptr<const CompanionFiles>& companions, const std::string& relative,
    const std::string& who);

}  // namespace strata::io
