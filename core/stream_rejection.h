// The minimum distance on samples that stream past.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "core/block.h"
#include "core/external_sort.h"
#include "core/gather.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/territory.h"

namespace strata {

/// What survivors stand for that were left something by samples that were removed.
class Heirs {
 public:
  /// Memory: as ExternalSort of `memory_bytes`. Errors: kOverBudget.
  static Result<std::unique_ptr<Heirs>> Open(std::uint64_t memory_bytes, RunContext& context);

  /// In any order. Errors: those of ExternalSort::Add.
  Result<void> Add(std::uint64_t number, FixedArea area);
  Result<void> Sort();
  /// The area noted for the sample of this number, or else `own`. Numbers ascend from call to call,
  /// and none is left out for which an area was noted.
  Result<FixedArea> AreaOf(std::uint64_t number, FixedArea own);

 private:
  explicit Heirs(std::unique_ptr<ExternalSort> sorted) : sorted_(std::move(sorted)) {}
  std::unique_ptr<ExternalSort> sorted_;
  std::uint64_t next_[2] = {0, 0};  // Number and area; used up if has_next_ is false.
  bool has_next_ = false, at_end_ = false;
};

/// Which of numbered samples survive.
class Survivors {
 public:
  explicit Survivors(std::uint64_t samples) : bits_((samples + 63) / 64) {}
  /// Null where areas are not wanted.
  Heirs* heirs() const { return heirs_.get(); }
  void SetHeirs(std::unique_ptr<Heirs> heirs) { heirs_ = std::move(heirs); }
  void Add(std::uint64_t number) { bits_[number / 64] |= std::uint64_t{1} << (number % 64); }
  bool Has(std::uint64_t number) const { return (bits_[number / 64] >> (number % 64) & 1) != 0; }
  static std::uint64_t BytesFor(std::uint64_t samples) { return samples / 8 + 8; }

  std::uint64_t count = 0;  ///< Of a territory: its own alone, as the bounds.
  Bounds bounds;            ///< World units.
  /// Blocks of a territory whose samples depend on blocks beyond; ascending.
  std::vector<Cell> undecided;

 private:
  std::vector<std::uint64_t> bits_;
  std::unique_ptr<Heirs> heirs_;
};

/// The sample of a reservoir in world units, kept within the surface's bounds.
Vec3 PositionOf(const GatherOptions& options, Cell cell, const Reservoir& reservoir);

/// What a stream holds.
struct StreamedBlocks {
  std::span<const Cell> places;          ///< Of all its blocks, ascending.
  std::uint64_t samples = 0;             ///< In all of them.
  const Territory* territory = nullptr;  ///< Null = these are all the blocks there are.
};

/// Decides as RejectClosePoints does on all samples at once, which `stream` hands over block by
/// block.
///
/// A component of the conflict graph is settled as soon as none of its samples can be close to one
/// in a block that is still to come (docs/adr/0009); the others stay in a window of at most
/// `window_bytes`. A component that may reach a block beyond the stream is never settled. Errors:
/// the stream's; kCancelled; kOverBudget when the window is too small for what hangs together, with
/// the number of bytes it needs at least.
Result<Survivors> RejectStream(BlockStream& stream, const StreamedBlocks& blocks,
                               const GatherOptions& options, std::uint64_t window_bytes,
                               RunContext& context);

}  // namespace strata
