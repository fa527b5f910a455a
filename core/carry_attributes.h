// Between gathering and writing: what the mesh carries, brought to its samples.
#pragma once

#include <cstddef>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/sample_mesh.h"

namespace strata {

/// Which of a mesh's attributes samples are to carry.
struct CarryPlan {
  std::vector<std::size_t> wanted;    ///< Numbers in MeshReader::attributes(), ascending.
  std::optional<std::size_t> normal;  ///< Of the one that becomes the normal, if any does.

  bool empty() const { return wanted.empty() && !normal; }
};

/// Finds what SampleOptions::mesh_attributes and vertex_normals ask for. A name stands for the
/// attribute of that name and for all of that meaning ("color", "uv", "material", …); "all" for
/// everything there is. Errors: kInvalidArgument, listing what is there, with types.
Result<CarryPlan> PlanCarry(std::span<const MeshAttribute> present, const SampleOptions& options);

/// Asks `reader` whether what a plan's attributes need is at hand (MeshReader::CheckAttribute).
/// What is missing or damaged, but was asked for by "all" alone, leaves the plan and is returned:
/// "name: reason". Errors: those of attributes asked for by name or meaning, and all but kNotFound,
/// kUnsupported and kCorruptInput.
Result<std::vector<std::string>> LeaveOutAbsent(MeshReader& reader, const SampleOptions& options,
                                                CarryPlan& plan, RunContext& context);

/// The fixed attributes that must be gathered for a plan, those of the options included.
AttributeSet GatheredFor(const CarryPlan& plan, const SampleOptions& options);

/// Replaces `sampled.samples` by the same samples with the plan's attributes, fetched for them
/// alone in one pass of `reader`, and without fixed columns that options.attributes does not name.
/// The samples must have those of GatheredFor.
///
/// Memory: the samples and 48 bytes each while they fit half of what is left of the context's
/// account; otherwise all of it goes through scratch space and is sorted there. Errors: those of
/// the samples and of the reader's pass; kOverBudget, kIo, kCancelled.
Result<void> CarryAttributes(MeshReader& reader, const CarryPlan& plan,
                             const SampleOptions& options, SampledMesh& sampled,
                             RunContext& context);

}  // namespace strata
