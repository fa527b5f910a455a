// What Draco data say of themselves before they are decoded.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/memory_account.h"
#include "core/result.h"

namespace strata::io {

/// The head of a Draco mesh.
struct DracoHeader {
  std::uint64_t faces = 0;
  std::uint64_t points = 0;      ///< Vertices, those that a split adds included.
  std::uint64_t attributes = 0;  ///< Besides positions, with a connectivity of their own.
  bool edgebreaker = false;
};

/// Reads the head of `bytes`, all of the data. `who` is for messages. Errors: kUnsupported: a point
/// cloud, a version after 2.2; kCorruptInput, also for more faces or points than the bytes can
/// hold.
Result<DracoHeader> ReadDracoHeader(std::string_view bytes, const std::string& who);

/// What decoding takes at most, bytes, the data themselves aside.
std::uint64_t DracoDecodeBytes(const DracoHeader& header);

}  // namespace strata::io
