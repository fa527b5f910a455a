// What strata-assimp writes for Strata to read: numbers in the machine's byte order.
#pragma once

#include <cstdint>

namespace strata::io {

/// A record's first four bytes. Texts are their length in four bytes, then their bytes.
enum class AssimpRecord : std::uint32_t {
  /// Once, first: five 64-bit counts: vertices, meshes, placings of meshes, points, lines. A text:
  /// the format's name. A 32-bit number of materials, and their names as texts. A text: the up
  /// axis.
  kHead = 0x31415341,
  /// A 32-bit number of corners, then three doubles for each.
  kPolygon = 0x32415341,
  /// Last.
  kEnd = 0x33415341,
  /// Instead of anything else: 1 for lack of memory, 2 for a format that is not read, 0 for other
  /// reasons, in 32 bits; a text.
  kFailure = 0x34415341,
};

/// Where the child finds the mesh.
inline constexpr int kAssimpInput = 3;
/// More corners than this no polygon has.
inline constexpr std::uint32_t kMostAssimpCorners = 1u << 20;

}  // namespace strata::io
