#include "io/vertex_window.h"

#include <algorithm>
#include <cstring>

namespace strata::io {
namespace {

// Pages of 8192 vertices, 96 or 192 KiB, unless that makes too few of them.
constexpr int kLargest = 13, kSmallest = 6;
constexpr std::uint64_t kWanted = 16, kFewest = 4;
constexpr std::uint64_t kFrameOverhead = sizeof(std::uint64_t) + 1;

std::uint64_t PagesOf(const VertexFile& file, int shift) { return (file.size() >> shift) + 1; }
std::uint64_t TableBytes(const VertexFile& file, int shift) {
  return PagesOf(file, shift) * sizeof(std::uint32_t);
}
std::uint64_t FrameBytes(const VertexFile& file, int shift) {
  return (std::uint64_t{file.vertex_bytes()} << shift) + kFrameOverhead;
}
std::uint64_t FramesWithin(const VertexFile& file, int shift, std::uint64_t budget) {
  const std::uint64_t table = TableBytes(file, shift);
  return table < budget ? (budget - table) / FrameBytes(file, shift) : 0;
}

// The largest pages of which there are enough, or else the size that gives the most.
int ChooseShift(const VertexFile& file, std::uint64_t budget) {
  int best = kLargest;
  for (int shift = kLargest; shift >= kSmallest; --shift) {
    const std::uint64_t frames = FramesWithin(file, shift, budget);
    if (frames >= kWanted) return shift;
    if (frames > FramesWithin(file, best, budget)) best = shift;
  }
  return best;
}

}  // namespace

std::uint64_t VertexWindow::LeastBudget(const VertexFile& file) {
  std::uint64_t least = ~std::uint64_t{0};
  for (int shift = kSmallest; shift <= kLargest; ++shift) {
    least = std::min(least, TableBytes(file, shift) + kFewest * FrameBytes(file, shift));
  }
  return least;
}

VertexWindow::VertexWindow(VertexFile& file, std::uint64_t budget)
    : file_(file), vertex_bytes_(file.vertex_bytes()), shift_(ChooseShift(file, budget)) {
  frame_bytes_ = vertex_bytes_ << shift_;
  mask_ = (std::uint64_t{1} << shift_) - 1;
  const std::uint64_t pages = PagesOf(file, shift_);
  const auto frames = static_cast<std::size_t>(std::min(pages, FramesWithin(file, shift_, budget)));
  frames_.Extend(frames * frame_bytes_);
  frame_of_.assign(static_cast<std::size_t>(pages), kAbsent);
  page_of_.assign(frames, kNoPage);
  used_.assign(frames, 0);
}

std::uint32_t VertexWindow::FreeFrame() {
  const auto frames = static_cast<std::uint32_t>(page_of_.size());
  if (taken_ < frames) return taken_++;
  while (used_[hand_] != 0) {
    used_[hand_] = 0;
    hand_ = hand_ + 1 == frames ? 0 : hand_ + 1;
  }
  const std::uint32_t frame = hand_;
  hand_ = hand_ + 1 == frames ? 0 : hand_ + 1;
  if (page_of_[frame] != kNoPage) frame_of_[page_of_[frame]] = kAbsent;
  page_of_[frame] = kNoPage;
  return frame;
}

std::uint32_t VertexWindow::Fault(std::uint64_t page) {
  ++faults_;
  const std::uint32_t frame = FreeFrame();
  char* const to = frames_.data() + frame * frame_bytes_;
  const std::uint64_t first = page << shift_;
  const std::uint64_t n = std::min(mask_ + 1, file_.size() - first);
  auto ok = failure_ ? Result<void>(tl::unexpected<Error>(*failure_))
                     : file_.Load(first, {to, static_cast<std::size_t>(n) * vertex_bytes_});
  if (!ok) {
    failure_ = ok.error();
    std::memset(to, 0, frame_bytes_);
    return frame;
  }
  frame_of_[page] = frame;
  page_of_[frame] = page;
  return frame;
}

}  // namespace strata::io
