// strata-vdb, the program that makes OpenVDB's grid, as its parent sees it.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"
#include "io/child_process.h"
#include "io/fd.h"
#include "io/vdb_stream.h"

namespace strata::io {

/// Starts the program, hands it a grid's head and points, and takes its answer. The child ends with
/// this. Threads: one at a time. Memory: 256 KiB.
class VdbChild {
 public:
  /// `name` begins messages; `context` may be null, otherwise its cancel flag is looked at at least
  /// every tenth of a second. It must outlive this.
  VdbChild(std::string name, const RunContext* context);

  /// The child fills `output`, which must outlive this. Errors: kNotFound (no such program), kIo.
  Result<void> Start(const std::string& program, VdbHead head, const ScratchFile& output);
  /// A row of VdbRowBytes. Errors: kIo, kCancelled; kOverBudget, once the child says so.
  Result<void> Send(std::span<const char> row);
  /// After the last row; the file's bytes. Errors: as Send.
  Result<std::uint64_t> Finish();

 private:
  Result<void> Flush();
  Result<void> Receive(std::span<char> out);
  Result<std::uint64_t> Answer();
  tl::unexpected<Error> Refused(const VdbAnswer& answer, const std::string& text) const;
  tl::unexpected<Error> System(const char* what) const;
  Result<bool> Wait(short events) const;

  std::string name_, disk_;
  const RunContext* context_;
  Fd socket_;
  std::string buffer_;
  std::uint64_t points_ = 0, memory_bytes_ = 0;
  ChildProcess process_;  // Ends first.
};

}  // namespace strata::io
