// One pass over a mesh: read in order by one thread, worked on by all.
#pragma once

#include <cstddef>
#include <functional>

#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"

namespace strata {

/// Rewinds `reader` and hands all its triangles to `work`, `batch_size` or fewer at a time, in any
/// order and on any thread of the arena in which it is called. What `work` returns may end the
/// pass. Memory: two batches a thread, kBatchTriangleBytes a triangle. Errors: the reader's, those
/// of `work`, kCancelled.
using BatchWork = std::function<Result<void>(const TriangleBatch& batch)>;
Result<void> ForEachBatch(MeshReader& reader, std::size_t batch_size, RunContext& context,
                          const BatchWork& work);

/// What a batch takes, bytes.
inline constexpr std::size_t kBatchTriangleBytes = 9 * sizeof(double) + sizeof(std::uint64_t);

}  // namespace strata
