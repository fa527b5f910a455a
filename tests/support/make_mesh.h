// Meshes of any size, written straight to disk.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "core/result.h"

namespace strata::test {

/// A pseudo-random permutation of [0, n) that needs no table: a Feistel network over the next power
/// of four, walked until it comes back into the range. The same for the same n and seed.
class Permutation {
 public:
  explicit Permutation(std::uint64_t n, std::uint64_t seed);
  std::uint64_t operator()(std::uint64_t i) const;
  /// The number that operator() takes to `i`.
  std::uint64_t Inverse(std::uint64_t i) const;

 private:
  static constexpr int kRounds = 6;
  std::uint64_t Round(int round, std::uint64_t half) const;
  std::uint64_t n_, half_mask_;
  int half_bits_ = 1;
  std::array<std::uint64_t, kRounds> keys_;
};

/// A mesh that is computed, not stored: any vertex, any triangle, at any time.
struct ComputedMesh {
  std::uint64_t vertices = 0, triangles = 0;
  std::function<std::array<float, 3>(std::uint64_t)> vertex;
  std::function<std::array<std::uint64_t, 3>(std::uint64_t)> triangle;
};

/// A sphere of about `triangles` triangles (80 at least, an even number) whose surface is displaced
/// by waves of all lengths, so that no two parts of it look the same. Row by row, coherent.
ComputedMesh FractalSphere(std::uint64_t triangles, std::uint64_t seed = 1);

/// `mesh` side by side on a square grid until there are `triangles`; the last copy may be cut
/// short. `mesh` and what it refers to must outlive the result.
ComputedMesh Tiled(const ComputedMesh& mesh, std::uint64_t triangles);

/// The same mesh with its vertices in another order: neighbours in the file no longer name
/// neighbouring vertices, but still share them.
ComputedMesh Shuffled(ComputedMesh mesh, std::uint64_t seed);
/// The same mesh with its triangles in another order.
ComputedMesh ShuffledFaces(ComputedMesh mesh, std::uint64_t seed);

/// The mesh in a binary little-endian PLY file with float x, y, z first in its rows, if all its
/// faces are triangles. Held in memory. Errors: those of the reader.
Result<ComputedMesh> ScanFromPly(const std::string& path);

enum class MeshFormat : std::uint8_t { kPly, kPlyAscii, kStl, kObj };

/// "ply", "ply-ascii", "stl", "obj".
std::optional<MeshFormat> MeshFormatNamed(const std::string& name);

/// Writes `mesh` to `path`, a few MiB at a time. Errors: kIo; kInvalidArgument if the format cannot
/// count that many.
Result<void> WriteMesh(const ComputedMesh& mesh, MeshFormat format, const std::string& path);

}  // namespace strata::test
