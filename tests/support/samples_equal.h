// Comparing samples bit by bit.
#pragma once

#include <gtest/gtest.h>

#include <bit>
#include <cstring>
#include <string>

#include "core/sample_mesh.h"

namespace strata::test {

template <class T>
::testing::AssertionResult SameColumn(const std::vector<T>& a, const std::vector<T>& b,
                                      const char* name) {
  if (a.size() != b.size()) {
    return ::testing::AssertionFailure() << name << ": " << a.size() << " and " << b.size();
  }
  for (std::size_t i = 0; i < a.size(); ++i) {
    if (std::memcmp(&a[i], &b[i], sizeof(T)) != 0) {
      return ::testing::AssertionFailure() << name << " of sample " << i << " differs";
    }
  }
  return ::testing::AssertionSuccess();
}

/// Whether two results agree bit by bit: positions, normals, cells, areas and barycentric weights;
/// not triangle numbers, which name a file's own order.
inline ::testing::AssertionResult SameSamples(const SampleColumns& a, const SampleColumns& b) {
  for (const auto& same :
       {SameColumn(a.position, b.position, "position"), SameColumn(a.normal, b.normal, "normal"),
        SameColumn(a.cell, b.cell, "cell"), SameColumn(a.area, b.area, "area"),
        SameColumn(a.weight, b.weight, "weight")}) {
    if (!same) return same;
  }
  return ::testing::AssertionSuccess();
}

/// Whether what a run reports of the surface agrees.
inline ::testing::AssertionResult SameStats(const SampleStats& a, const SampleStats& b) {
  const auto differs = [](const std::string& what) {
    return ::testing::AssertionFailure() << what;
  };
  if (a.cells != b.cells) return differs("cells");
  if (a.pieces != b.pieces) return differs("pieces");
  if (a.survivors != b.survivors) return differs("survivors");
  if (a.surface_hash != b.surface_hash) return differs("surface hash");
  if (a.cell_area != b.cell_area) return differs("cell area");
  if (!(a.lattice.origin == b.lattice.origin) || a.lattice.edge != b.lattice.edge) {
    return differs("lattice");
  }
  if (a.bounds != b.bounds) return differs("bounds");
  return ::testing::AssertionSuccess();
}

}  // namespace strata::test
