// OpenVDB's grid of points in the making.
#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>

#include "io/vdb_stream.h"

namespace strata::server {

/// Why the file could not be written: errno.
struct DiskError : std::runtime_error {
  explicit DiskError(int errno_of_write);
  int number;
};

/// Takes points leaf by leaf and writes the grid. Threads: one at a time; none of its own. Memory:
/// as bytes() says.
class PointGrid {
 public:
  /// Precondition: names and types of head.attributes are OpenVDB's. Throws what OpenVDB throws.
  explicit PointGrid(const io::VdbHead& head);
  ~PointGrid();

  /// The next point, a row of io::VdbRowBytes. Points of one leaf follow each other.
  void Add(const char* row);
  /// After the last point.
  void End();
  /// What the grid takes, or would take: when that is more than head.memory_bytes it is given up,
  /// and further points are only counted.
  std::uint64_t bytes() const;
  bool over_memory() const;

  /// After End, unless over_memory(): writes the grid to `descriptor`, from byte 0. The bytes
  /// depend on head and points alone. Returns how many. Throws DiskError, and what OpenVDB throws.
  std::uint64_t Write(int descriptor);

 private:
  class Leaves;
  std::unique_ptr<Leaves> leaves_;
};

}  // namespace strata::server
