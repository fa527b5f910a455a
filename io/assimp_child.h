// The process that runs strata-assimp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/run_context.h"
#include "io/assimp_records.h"
#include "io/child_process.h"
#include "io/fd.h"

namespace strata::io {

/// What the child is to do.
struct AssimpOrder {
  std::string program;       ///< Its path.
  int input = -1;            ///< A descriptor of the mesh; stays the caller's.
  std::uint64_t memory = 0;  ///< Bytes that it may use.
  std::string suffix;        ///< Of the mesh's name: which format it might be.
  bool attributes = false;   ///< Whether corners shall carry values.
};

/// A child and the pipe from it; killed when it goes. Threads: one.
class AssimpChild : public AssimpFeed {
 public:
  /// `name` is the mesh's, for messages; `context` (may be null) is polled for its cancel flag.
  AssimpChild(std::string name, const RunContext* context)
      : name_(std::move(name)), context_(context), buffer_(std::size_t{1} << 18) {}

  /// Once. Errors: kNotFound (no such program), kIo.
  Result<void> Start(const AssimpOrder& order);
  /// What it wrote. Errors: kCorruptInput, with how it died; kCancelled; kIo.
  Result<void> Take(std::span<char> out) override;

 private:
  tl::unexpected<Error> System(const char* what) const;
  Result<void> Fill();
  tl::unexpected<Error> Died();

  const std::string name_;
  const RunContext* context_;
  Fd pipe_;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
  ChildProcess process_;  // Ends first.
};

}  // namespace strata::io
