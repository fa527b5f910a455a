// Pieces that provenance, summary and info have in common. Only .cc files include this one.
#pragma once

#include <nlohmann/json.hpp>

#include "core/lattice.h"
#include "core/mesh_reader.h"
#include "core/sample_mesh.h"
#include "core/samples.h"

namespace strata::server {

/// Keeps the order in which keys are added.
using Json = nlohmann::ordered_json;

Json ToJson(Vec3 v);                ///< [x, y, z]
Json ToJson(const Bounds& bounds);  ///< {"min": …, "max": …}, or null when empty.
Json ToJson(const MeshInfo& info);  ///< {"format": …, "encoding": …, "compression": …}
/// What the file holds beside triangles; null where its format does not say.
Json ContentsToJson(const MeshContents& contents);
Json SkippedToJson(const SkipCounts& skipped);  ///< Reason → count, all reasons.
/// Names of the fixed ones in the order of the bits, then the mesh's as they were asked for.
Json AttributesToJson(const SampleOptions& options);
Json ToJson(const std::vector<MeshAttribute>& attributes);  ///< Without the tables of names.
Json LatticeToJson(const LatticeSpec& spec, const Lattice& lattice);
/// The options that decide the samples, each under its name on the command line.
Json OptionsToJson(const SampleOptions& options, double position_error, const SampleStats& stats);

}  // namespace strata::server
