// A window of pages over vertices on disk.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/result.h"
#include "io/vertex_array.h"
#include "io/vertex_file.h"

namespace strata::io {

/// Looks vertices up by number through pages that are read when they are needed; a page not used
/// for a while (second chance, which is near to least recently used) gives way.
///
/// Pages are read, not mapped: a mapped file's pages would count as the process's own. Failures are
/// kept: after one, what Find returns is of no use. Threads: one at a time.
class VertexWindow {
 public:
  /// The fewest bytes that a window over `file` can do with.
  static std::uint64_t LeastBudget(const VertexFile& file);

  /// Precondition: LeastBudget(file) <= budget. `file` must outlive the window. Throws
  /// std::bad_alloc. Memory: at most `budget`, touched as it fills.
  VertexWindow(VertexFile& file, std::uint64_t budget);

  /// The vertex's coordinates in the file's precision, valid until the next call.
  const char* Find(std::uint64_t index) {
    const std::uint64_t page = index >> shift_;
    std::uint32_t frame = frame_of_[page];
    if (frame == kAbsent) [[unlikely]]
      frame = Fault(page);
    used_[frame] = 1;
    return frames_.data() + frame * frame_bytes_ + (index & mask_) * vertex_bytes_;
  }

  const std::uint64_t& faults() const { return faults_; }
  std::uint64_t page_bytes() const { return frame_bytes_; }
  std::uint64_t bytes() const { return page_of_.size() * frame_bytes_; }
  bool failed() const { return failure_.has_value(); }
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(*failure_); }

 private:
  static constexpr std::uint32_t kAbsent = 0xffffffff;
  static constexpr std::uint64_t kNoPage = ~std::uint64_t{0};

  std::uint32_t Fault(std::uint64_t page);
  std::uint32_t FreeFrame();

  VertexFile& file_;
  std::size_t vertex_bytes_, frame_bytes_;
  int shift_;
  std::uint64_t mask_;
  GrowArray<char> frames_;
  std::vector<std::uint32_t> frame_of_;  // By page.
  std::vector<std::uint64_t> page_of_;   // By frame.
  std::vector<std::uint8_t> used_;       // By frame: since the hand last came by.
  std::uint32_t taken_ = 0, hand_ = 0;
  std::uint64_t faults_ = 0;
  std::optional<Error> failure_;
};

}  // namespace strata::io
