// The main job: triangles in, stratified samples out.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "core/cell_octree.h"
#include "core/lattice.h"
#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"
#include "core/samples.h"

namespace strata {

/// Limits of the options below.
inline constexpr double kMaxLambda = 500;  ///< Beyond it exp(-lambda * d) leaves a double's range.
inline constexpr double kMaxMinDistance = 4;
/// World units; nearer to the ends of a double's range, areas in units of a cell's face would leave
/// it.
inline constexpr double kMinEdge = 1e-60, kMaxEdge = 1e60;
inline constexpr std::uint32_t kMaxResolution = 1u << 29;
inline constexpr std::uint32_t kMaxHeight = 30;

inline constexpr std::uint64_t kMaxCount = std::uint64_t{1} << 40;

enum class Method : std::uint8_t {
  kStratified,  ///< One sample per occupied cell, then the minimum distance.
  kUniform,     ///< Independent samples, uniform by area: core/uniform.h, docs/adr/0016.
};

enum class Integrator : std::uint8_t {
  kExact,      ///< The race: the law itself, no subdivision (docs/adr/0002).
  kSubdivide,  ///< The paper's own subdivision, as its authors' program does it.
};

/// What to do. Everything above the line decides the samples; what is below it never does.
struct SampleOptions {
  LatticeSpec lattice = Resolution{};
  double lambda =
      5;  ///< Decay of the density, per cell edge; 0 = uniform. 0 <= lambda <= kMaxLambda.
  double min_distance = 0.5;  ///< Fraction of the edge; 0 = off. 0 <= m <= kMaxMinDistance.
  std::uint64_t seed = 0;
  Integrator integrator = Integrator::kExact;
  Method method = Method::kStratified;
  /// Of kUniform, how many samples, at most kMaxCount; then lambda, min_distance and integrator
  /// have no say. 0 = as many as kStratified keeps with the same options.
  std::uint64_t count = 0;
  AttributeSet attributes = kNormal;
  /// What else samples take from the mesh: names of attributes or of what they mean (PlanCarry).
  std::vector<std::string> mesh_attributes;
  bool vertex_normals = false;  ///< kNormal is interpolated from the mesh's normals.
  bool strict = false;          ///< Any skipped triangle is an error (kCorruptInput).
  // ---
  int threads = 0;                ///< 0 = all the processors this process may use.
  std::size_t batch_size = 2048;  ///< Triangles per batch, >= 1.
  /// More occupied cells than this are an error (kOverBudget), found while they are counted, not
  /// after the memory is gone. Give or take what the workers' caches hold.
  std::uint64_t max_cells = std::numeric_limits<std::uint64_t>::max();
  /// Occupied cells of a parcel (core/parcels.h), at most; 0 = no parcels are found.
  std::uint64_t parcel_cells = 0;
};

/// What happened. Byte counts and times are for people; the rest is a function of surface, options
/// and seed.
struct SampleStats {
  ReadCounts read;            ///< What the reader saw; of a share, its part (ScanTotals::read).
  SkipCounts skipped{};       ///< All skipped triangles by reason (reader's and core's).
  std::uint64_t sampled = 0;  ///< Triangles of positive area that were raced.
  Bounds bounds;              ///< Of the sampled triangles; world units.
  double mesh_area = 0;       ///< Sum of the triangles' areas; world units squared.
  double cell_area =
      0;  ///< Sum over the cells of the surface inside; equals mesh_area within 1e-6.
  Lattice lattice;
  std::string surface_hash;     ///< 32 hex digits; see docs/adr/0003.
  std::uint64_t cells = 0;      ///< Occupied cells = samples before rejection.
  std::uint64_t pieces = 0;     ///< Triangle ∩ cell pairs of positive area.
  std::uint64_t survivors = 0;  ///< Samples after rejection.
  double lattice_seconds = 0, scan_seconds = 0, reject_seconds = 0;  ///< Wall time by stage.
  double carry_seconds = 0;      ///< Of that, for the mesh's attributes.
  std::uint64_t resumed_at = 0;  ///< The triangles before this one were a former process's work.
  int passes = 1;                ///< How often the triangles were read.
  /// Attributes that "all" would have taken and that are missing or damaged: "texture: …: reason".
  std::vector<std::string> left_out{};
};

struct SampleResult {
  SampleColumns samples;  ///< Survivors in canonical order: by block of 8^3 cells, then by cell.
  SampleStats stats;
  std::vector<MeshAttribute> carried = {};  ///< What samples.carried holds.
};

/// What is known once the samples are decided, and the samples on their way out.
struct SampledMesh {
  SampleStats stats;
  Bounds bounds;                          ///< Of the survivors; world units.
  std::vector<OctreeNode> parcels;        ///< Of all cells, if options.parcel_cells asks for them.
  std::vector<MeshAttribute> carried;     ///< What the samples' carried columns hold.
  std::unique_ptr<SampleSource> samples;  ///< `stats.survivors` of them.
};

/// Samples the whole of `reader`, in as much memory as is left of the context's account.
///
/// The samples are a function of the surface, the options above the line and the seed (promise 3).
/// Threads: uses up to `options.threads`, fewer if their buffers do not fit; call from one. Memory:
/// the reader's, plus 15 MB per thread, plus at most kBytesPerCell per occupied cell - or, with a
/// limited account, what is left of that: the rest goes to the context's scratch space (kUniform:
/// core/uniform.h).
/// Errors: the reader's; kInvalidArgument (options out of range, or an attribute that the mesh does
/// not carry, which is found before any work), kEmptySurface, kOverBudget (cell
/// coordinates beyond 2^30, more than max_cells, or a stage that does not fit its share of memory),
/// kCancelled, kCorruptInput (strict), kIo (scratch space). The reader and the context must outlive
/// the samples.
inline constexpr std::uint64_t kBytesPerCell = 400;
Result<SampledMesh> SampleMeshStreamed(MeshReader& reader, const SampleOptions& options,
                                       RunContext& context);

/// The same, gathered in memory.
Result<SampleResult> SampleMesh(MeshReader& reader, const SampleOptions& options,
                                RunContext& context);

}  // namespace strata
