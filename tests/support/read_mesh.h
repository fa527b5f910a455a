// Reading a whole mesh into memory, for tests.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/mesh_reader.h"

namespace strata::test {

/// Everything a reader gave.
struct WholeMesh {
  std::vector<std::array<Vec3, 3>> triangles;
  std::vector<std::uint64_t> ids;
  std::vector<Vec3> vertices;
  ReadCounts counts;
  MeshInfo info;

  std::uint64_t skipped(SkipReason reason) const {
    return counts.skipped[static_cast<std::size_t>(reason)];
  }
};

inline Result<WholeMesh> ReadWhole(MeshReader& reader, std::size_t batch_size = 64) {
  WholeMesh mesh;
  TriangleBatch batch(batch_size);
  for (;;) {
    auto n = reader.Read(batch);
    if (!n) return Forward(n);
    if (*n == 0) break;
    for (std::size_t i = 0; i < *n; ++i) {
      mesh.triangles.push_back({batch.corner(i, 0), batch.corner(i, 1), batch.corner(i, 2)});
      mesh.ids.push_back(batch.ids()[i]);
    }
  }
  for (std::size_t i = 0; i < reader.vertices().size(); ++i) {
    mesh.vertices.push_back(reader.vertices()[i]);
  }
  mesh.counts = reader.counts();
  mesh.info = reader.info();
  return mesh;
}

inline Result<WholeMesh> ReadWhole(Result<std::unique_ptr<MeshReader>> reader,
                                   std::size_t batch_size = 64) {
  if (!reader) return Forward(reader);
  return ReadWhole(**reader, batch_size);
}

}  // namespace strata::test
