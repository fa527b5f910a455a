// What strata-assimp writes for Strata to read: numbers in the machine's byte order.
#pragma once

#include <cstdint>

namespace strata::io {

/// A record's first four bytes. Texts are their length in four bytes, then their bytes; lists of
/// texts a 32-bit number of them, then the texts.
enum class AssimpRecord : std::uint32_t {
  /// Once, first: five 64-bit counts: vertices, meshes, placings of meshes, points, lines. A text:
  /// the format's name. A list: the materials' names. A text: the up axis. Three 32-bit numbers:
  /// whether there are normals, how many sets of colours, of texture coordinates. Two lists: the
  /// names of meshes, and of the nodes that place them.
  kHead = 0x31415341,
  /// A 32-bit number of corners, then three doubles for each; of the attributes' run then for each
  /// corner, in floats, all that the head names: normal (3), colours (4 each), texture coordinates
  /// (2 each). What a mesh does not have is NaN, of colours 1.
  kPolygon = 0x32415341,
  /// Last.
  kEnd = 0x33415341,
  /// Instead of anything else: 1 for lack of memory, 2 for a format that is not read, 0 for other
  /// reasons, in 32 bits; a text.
  kFailure = 0x34415341,
  /// Whose polygons follow: the numbers of mesh, node and material, 32 bits each.
  kPlaced = 0x35415341,
};

/// The third argument: positions alone, or everything.
inline constexpr char kAssimpSurface[] = "surface", kAssimpAttributes[] = "attributes";
/// Where the child finds the mesh.
inline constexpr int kAssimpInput = 3;
/// More corners than this no polygon has.
inline constexpr std::uint32_t kMostAssimpCorners = 1u << 20;
/// More sets of colours, or of texture coordinates, than this no mesh has.
inline constexpr std::uint32_t kMostAssimpSets = 8;
/// More names than this no list has, and no name more bytes.
inline constexpr std::uint32_t kMostAssimpNames = 1u << 20, kMostAssimpText = 4096;

}  // namespace strata::io
