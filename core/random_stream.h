// Randomness keyed by (seed, cell, triangle), never by thread or by position in a stream.
#pragma once

#include <Random123/philox.h>

#include <array>
#include <cstdint>

#include "core/vec3.h"

namespace strata {

/// Multipliers that spread a cell's coordinates over the counter.
inline constexpr std::array<std::uint64_t, 3> kCellMultipliers = {
    0x9e3779b97f4a7c15ULL, 0xd1b54a32d192ed03ULL, 0x8cb92ba72f3d8dd7ULL};

/// A cell's coordinates spread over 64 bits.
inline std::uint64_t CellOffset(Cell cell) {
  return static_cast<std::uint64_t>(std::int64_t{cell.x}) * kCellMultipliers[0] +
         static_cast<std::uint64_t>(std::int64_t{cell.y}) * kCellMultipliers[1] +
         static_cast<std::uint64_t>(std::int64_t{cell.z}) * kCellMultipliers[2];
}

/// The counter's low half for a triangle (its hash) in a cell.
inline std::uint64_t StreamCounter(std::uint64_t triangle_hash, Cell cell) {
  return triangle_hash + CellOffset(cell);
}

/// The random numbers of one part of one piece: Philox4x32-10 (Salmon et al. 2011, "Parallel random
/// numbers: as easy as 1, 2, 3"), addressed by block number. Asking again repeats the answer.
class RandomStream {
 public:
  using Block = std::array<std::uint32_t, 4>;

  RandomStream(std::uint64_t seed, std::uint64_t triangle_hash, Cell cell, std::uint32_t part)
      : seed_(seed), counter_(StreamCounter(triangle_hash, cell)), part_(part) {}

  Block operator()(std::uint32_t index) const {
    const r123::Philox4x32::ctr_type counter{{static_cast<std::uint32_t>(counter_),
                                              static_cast<std::uint32_t>(counter_ >> 32), part_,
                                              index}};
    const r123::Philox4x32::key_type key{
        {static_cast<std::uint32_t>(seed_), static_cast<std::uint32_t>(seed_ >> 32)}};
    const auto out = r123::Philox4x32{}(counter, key);
    return {out[0], out[1], out[2], out[3]};
  }

 private:
  std::uint64_t seed_, counter_;
  std::uint32_t part_;
};

/// Uniform in [0,1), a multiple of 2^-53. At least high * 2^-32.
inline double UniformFrom(std::uint32_t high, std::uint32_t low) {
  const auto bits = static_cast<std::int64_t>((std::uint64_t{high} << 32 | low) >> 11);
  return static_cast<double>(bits) * 0x1p-53;
}

/// Uniform in (0,1), 32 bits.
inline double UniformFrom(std::uint32_t word) { return (word + 0.5) * 0x1p-32; }

}  // namespace strata
