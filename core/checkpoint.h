// Checkpoints: what a job that was killed goes on from (`--resume`).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/lattice.h"
#include "core/run_file.h"
#include "core/scan.h"
#include "core/scratch.h"

namespace strata {

/// A job's place on scratch disk that outlives the process: its runs, and its last checkpoint.
/// Threads: one at a time.
class CheckpointPlace {
 public:
  virtual ~CheckpointPlace() = default;
  /// The file for the job's runs, of which the first `keep` bytes are what a former process left.
  /// With 0 it is a new one, and there is no checkpoint any more. Errors: kIo.
  virtual Result<std::unique_ptr<ScratchFile>> OpenRuns(std::uint64_t keep) = 0;
  /// The checkpoint to go on from, if there is one and the job is to go on. Errors: kIo.
  virtual Result<std::optional<std::string>> Load() = 0;
  /// Replaces the checkpoint, whole or not at all. Errors: kIo.
  virtual Result<void> Save(std::string_view bytes) = 0;
};

/// All that a scan has come to when every triangle before `scan.next` is in the runs.
struct Checkpoint {
  Lattice lattice;
  std::optional<Bounds> bounds;       ///< The surface must have these bounds,
  std::vector<std::uint64_t> probes;  ///< and these vertices, for the lattice to be the right one.
  ScanState scan;
  std::vector<RunExtent> runs;
};

/// As bytes, compressed and with a checksum. Errors: kInternal.
Result<std::string> PackCheckpoint(const Checkpoint& checkpoint);

/// Errors: kIo: damaged, or of another version's format.
Result<Checkpoint> UnpackCheckpoint(std::string_view bytes);

}  // namespace strata
