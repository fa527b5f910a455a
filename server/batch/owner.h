// One batch at a time in a folder of outputs.
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "io/fd.h"

namespace strata::server {

/// Held while a batch writes into a folder. A batch that shares its models with others (--share)
/// excludes only those of the same share and those that share nothing.
class Owner {
 public:
  /// `folder`: the folder of state. `share`: "" or "I-of-N". Errors: kConflict, naming the process
  /// that has it; kIo. On file systems without locks, nothing is held.
  static Result<Owner> Take(const std::string& folder, const std::string& share);
  Owner(Owner&&) = default;
  Owner& operator=(Owner&&) = default;
  ~Owner() = default;

  /// Whether a former owner did not come to its end.
  bool former_was_killed() const { return former_was_killed_; }
  /// The work came to its end.
  void Finish();

 private:
  Owner() = default;
  io::Fd whole_, share_;
  std::string mark_;  // A file that is there while an owner works.
  bool former_was_killed_ = false;
};

}  // namespace strata::server
