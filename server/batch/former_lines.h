// What former batches, of this share and of others, left of a model.
#pragma once

#include <string>
#include <vector>

#include "core/result.h"
#include "server/batch/manifest.h"

namespace strata::server {

/// The manifests in a folder of state: the one that a batch writes, and those of other shares as
/// they were when it began. Threads: any.
class FormerLines {
 public:
  /// `own`: the manifest that is written, named `own_name` in the folder; must outlive this.
  /// Errors: those of ManifestReader::Open, kIo.
  static Result<FormerLines> Open(const std::string& state, const std::string& own_name,
                                  Manifest& own);

  /// The last line of the path in each manifest, the own one first; those of pruned models are left
  /// out. Errors: those of ManifestReader::Find.
  Result<std::vector<ManifestLine>> Of(const std::string& path) const;
  /// Whether a manifest of another share has a line of the path.
  bool IsElsewhere(const std::string& path) const;
  /// Every path that has a line, in order of its bytes.
  std::vector<std::string> Paths() const;

 private:
  explicit FormerLines(Manifest& own) : own_(&own) {}

  Manifest* own_;
  std::vector<ManifestReader> others_;
};

/// Whether a line of `lines` says, later than `line`, that another output has taken its place.
bool IsOverruled(const ManifestLine& line, const std::vector<ManifestLine>& lines);

}  // namespace strata::server
