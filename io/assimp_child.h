// The process that runs strata-assimp.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/run_context.h"
#include "io/assimp_records.h"
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
  ~AssimpChild() override;
  AssimpChild(const AssimpChild&) = delete;
  AssimpChild& operator=(const AssimpChild&) = delete;

  /// Once. Errors: kNotFound (no such program), kIo.
  Result<void> Start(const AssimpOrder& order);
  /// What it wrote. Errors: kCorruptInput, with how it died; kCancelled; kIo.
  Result<void> Take(std::span<char> out) override;

 private:
  tl::unexpected<Error> System(const char* what) const;
  int Reap();
  Result<void> Fill();
  tl::unexpected<Error> Died();

  const std::string name_;
  const RunContext* context_;
  Fd pipe_;
  pid_t id_ = -1;
  std::vector<char> buffer_;
  std::size_t begin_ = 0, end_ = 0;
};

}  // namespace strata::io
