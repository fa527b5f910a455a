// What a mesh holds, in one streaming pass: `strata info`.
#pragma once

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"

namespace strata {

struct MeshSummary {
  ReadCounts read;
  SkipCounts skipped{};                 ///< By reason, the reader's and those found here.
  std::uint64_t surface_triangles = 0;  ///< Triangles of positive area.
  Bounds bounds;                        ///< Of the triangles of positive area; world units.
  Bounds vertex_bounds;  ///< Of all finite vertices, referenced or not; empty for STL.
  double area = 0;       ///< World units squared.
};

/// Reads every triangle once, serially, in O(1) memory beyond the reader's. An empty surface is not
/// an error here. Errors: the reader's, kCancelled.
Result<MeshSummary> SummarizeMesh(MeshReader& reader, RunContext& context);

}  // namespace strata
