// Reading ZIP archives, which may be hostile.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"
#include "io/byte_source.h"
#include "io/companion_file.h"

namespace strata::io {

/// The regular files of an archive, by name. Names are only ever compared, never opened.
///
/// Bounds: 65,536 members; all that is unpacked of one archive together is at most 200 times its
/// size, or 64 MiB if that is more, and 2^40 bytes. Memory: the names, small buffers. Threads: one
/// at a time.
class ZipArchive {
 public:
  /// `source`: ReadAt works. `scratch` (null: the system's) takes what is unpacked; `context` may
  /// be null, it and `scratch` must outlive the archive. Errors: kCorruptInput, kOverBudget, kIo.
  static Result<std::shared_ptr<ZipArchive>> Open(std::unique_ptr<ByteSource> source,
                                                  ScratchFolder* scratch,
                                                  const RunContext* context);

  /// In the archive's order.
  const std::vector<std::string>& names() const { return names_; }
  bool Has(const std::string& name) const;
  /// Unpacks a member into scratch space. Errors: kNotFound; kCorruptInput (its checksum, a name
  /// that stands there twice); kUnsupported (encrypted); kOverBudget (the bounds); kIo, kCancelled.
  Result<std::unique_ptr<ByteSource>> Extract(const std::string& name);
  /// The same, handed to `take` piece by piece instead; its errors are passed on.
  Result<void> Stream(const std::string& name,
                      const std::function<Result<void>(std::span<const char>)>& take);

  const std::string& name() const { return source_->name(); }
  std::uint64_t size() const { return source_->size().value_or(0); }

 private:
  ZipArchive(std::unique_ptr<ByteSource> source, ScratchFolder* scratch, const RunContext* context)
      : source_(std::move(source)), scratch_(scratch), context_(context) {}
  Result<void> List();
  std::uint64_t MostUnpacked() const;

  std::unique_ptr<ByteSource> source_;
  ScratchFolder* scratch_;
  const RunContext* context_;
  std::vector<std::string> names_;
  std::uint64_t unpacked_ = 0;
};

/// Companions of a mesh in the folder `folder` of `archive` ("": its root).
std::shared_ptr<const CompanionFiles> FilesInArchive(std::shared_ptr<ZipArchive> archive,
                                                     std::string folder);

}  // namespace strata::io
