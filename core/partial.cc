#include "core/partial.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "core/packing.h"
#include "core/version.h"

namespace strata {
namespace {

constexpr std::string_view kMagic = "STRATAPT";
constexpr std::uint32_t kFormat = 2;
constexpr std::uint32_t kMostInfoBytes = 64 << 20;

// The file begins with this; the info follows, then a run (core/run_file.h) to the end.
struct FileHeader {
  char magic[8];
  std::uint32_t format, compressed_bytes, info_bytes, reserved;
};

// A lattice's specification as two numbers.
struct SpecNumbers {
  std::uint64_t kind = 0;
  double value = 0;
};
SpecNumbers NumbersOf(const LatticeSpec& spec) {
  if (const auto* r = std::get_if<Resolution>(&spec)) return {0, static_cast<double>(r->n)};
  if (const auto* v = std::get_if<VoxelSize>(&spec)) return {1, v->edge};
  return {2, static_cast<double>(std::get<Height>(spec).h)};
}
LatticeSpec SpecOf(const SpecNumbers& numbers) {
  if (numbers.kind == 0) return Resolution{static_cast<std::uint32_t>(numbers.value)};
  if (numbers.kind == 1) return VoxelSize{numbers.value};
  return Height{static_cast<std::uint32_t>(numbers.value)};
}

template <class Archive, class Info>
void Fields(Archive& archive, Info& info) {
  archive.Range(info.version);
  archive.Value(info.mesh);
  archive.Value(info.lattice);
  archive.Value(info.lambda);
  archive.Value(info.seed);
  archive.Value(info.integrator);
  archive.Value(info.barycentric);
  archive.Value(info.share_count);
  archive.Range(info.shares);
  archive.Value(info.surface);
  archive.Value(info.bounds);
  archive.Value(info.mesh_area);
  archive.Value(info.read);
  archive.Value(info.skipped);
  archive.Value(info.sampled);
  archive.Value(info.pieces);
}

std::string Pack(const PartialInfo& info) {
  Packer packer;
  packer.Value(NumbersOf(info.spec));
  Fields(packer, info);
  return std::move(packer.bytes);
}

bool Unpack(std::string_view bytes, PartialInfo& info) {
  Unpacker unpacker(bytes);
  SpecNumbers spec;
  unpacker.Value(spec);
  Fields(unpacker, info);
  info.spec = SpecOf(spec);
  const auto& shares = info.shares;
  return unpacker.done() && !shares.empty() && shares.back() < info.share_count &&
         std::adjacent_find(shares.begin(), shares.end(), std::greater_equal<>()) == shares.end();
}

// --- Putting together ----------------------------------------------------------------------------

std::string Name(const Partial& partial) { return partial.file->name(); }

// What differs between two partials that should be of one job, or nothing.
std::string Difference(const PartialInfo& a, const PartialInfo& b) {
  const auto differ = [](const auto& x, const auto& y) {
    return std::memcmp(&x, &y, sizeof x) != 0;
  };
  if (a.version != b.version) return "the version of Strata";
  if (a.mesh != b.mesh) return "the mesh";
  if (a.share_count != b.share_count) return "the number of shares";
  const SpecNumbers x = NumbersOf(a.spec), y = NumbersOf(b.spec);
  if (x.kind != y.kind || differ(x.value, y.value)) return "the lattice asked for";
  if (differ(a.lattice, b.lattice)) return "the lattice";
  if (differ(a.lambda, b.lambda)) return "lambda";
  if (a.seed != b.seed) return "the seed";
  if (a.integrator != b.integrator) return "the integrator";
  if (a.barycentric != b.barycentric) return "whether barycentric weights were asked for";
  return {};
}

void Add(PartialInfo& to, const PartialInfo& from) {
  to.shares.insert(to.shares.end(), from.shares.begin(), from.shares.end());
  std::sort(to.shares.begin(), to.shares.end());
  to.surface.Add(from.surface);
  if (!from.bounds.empty()) {
    to.bounds.Add(from.bounds.min);
    to.bounds.Add(from.bounds.max);
  }
  to.mesh_area += from.mesh_area;
  to.read.Add(from.read);
  for (std::size_t r = 0; r < to.skipped.size(); ++r) to.skipped[r] += from.skipped[r];
  to.sampled += from.sampled;
  to.pieces += from.pieces;
}

bool Holds(const Partial& outer, const Partial& inner) {
  return std::includes(outer.info.shares.begin(), outer.info.shares.end(),
                       inner.info.shares.begin(), inner.info.shares.end());
}
bool Overlap(const Partial& a, const Partial& b) {
  return std::any_of(a.info.shares.begin(), a.info.shares.end(), [&](std::uint32_t s) {
    return std::binary_search(b.info.shares.begin(), b.info.shares.end(), s);
  });
}

tl::unexpected<Error> Damaged(const ScratchFile& file, const std::string& what) {
  return Fail(ErrorCode::kCorruptInput, file.name() + ": damaged partial: " + what);
}

}  // namespace

PartialInfo PartialOf(const ScannedMesh& scanned, const SampleOptions& options, const Share& share,
                      const std::array<std::uint64_t, 4>& mesh) {
  const SampleStats& stats = scanned.stats;
  PartialInfo info;
  info.version = kVersion;
  info.mesh = mesh;
  info.spec = options.lattice;
  info.lattice = stats.lattice;
  info.lambda = options.lambda;
  info.seed = options.seed;
  info.integrator = options.integrator;
  info.barycentric = (options.attributes & kBarycentric) != 0;
  info.share_count = share.count;
  info.shares = {share.index};
  info.surface = scanned.surface;
  info.bounds = stats.bounds;
  info.mesh_area = stats.mesh_area;
  info.read = stats.read;
  info.skipped = stats.skipped;
  info.sampled = stats.sampled;
  info.pieces = stats.pieces;
  return info;
}

Result<void> WritePartial(const AppendBytes& append, const PartialInfo& info, ReservoirStore& store,
                          RunContext& context) {
  const std::string packed = Pack(info);
  const auto sealed = Seal(packed);
  if (!sealed) return Forward(sealed);
  if (packed.size() > kMostInfoBytes) {
    return Fail(ErrorCode::kInternal, "a partial's info does not pack");
  }
  FileHeader header{{},
                    kFormat,
                    static_cast<std::uint32_t>(sealed->size()),
                    static_cast<std::uint32_t>(packed.size()),
                    0};
  std::memcpy(header.magic, kMagic.data(), kMagic.size());
  if (auto put = append({reinterpret_cast<const char*>(&header), sizeof header}); !put) return put;
  if (auto put = append(*sealed); !put) return put;
  auto stream = store.Blocks(context.memory());
  if (!stream) return Forward(stream);
  RunWriter run(append, sizeof header + sealed->size(), info.barycentric);
  if (auto extent = run.WriteAll(**stream, &context); !extent) return Forward(extent);
  return {};
}

Result<Partial> OpenPartial(std::unique_ptr<ScratchFile> file) {
  FileHeader header{};
  if (file->size() < sizeof header) return Damaged(*file, "it is shorter than a header");
  auto read = file->ReadAt(0, {reinterpret_cast<char*>(&header), sizeof header});
  if (!read) return Forward(read);
  if (std::string_view(header.magic, sizeof header.magic) != kMagic) {
    return Fail(ErrorCode::kUnsupported, file->name() + ": not a partial that strata scan wrote");
  }
  if (header.format != kFormat) {
    return Fail(ErrorCode::kUnsupported, file->name() + ": format " +
                                             std::to_string(header.format) +
                                             " of partials; expected " + std::to_string(kFormat));
  }
  if (header.info_bytes > kMostInfoBytes ||
      header.compressed_bytes > file->size() - sizeof header) {
    return Damaged(*file, "its info does not fit the file");
  }
  std::string sealed(header.compressed_bytes, 0);
  read = file->ReadAt(sizeof header, sealed);
  if (!read) return Forward(read);
  Partial partial;
  if (!Unpack(Unseal(sealed, header.info_bytes), partial.info)) {
    return Damaged(*file, "its info does not unpack");
  }
  partial.run.offset = sizeof header + header.compressed_bytes;
  partial.run.bytes = file->size() - partial.run.offset;
  partial.file = std::move(file);
  return partial;
}

Result<CombinedPartials> CombinePartials(std::vector<Partial> partials, RunContext& context) {
  // In an order of their own, so that sums of doubles do not depend on the caller's.
  std::stable_sort(partials.begin(), partials.end(), [](const Partial& a, const Partial& b) {
    if (a.info.shares.size() != b.info.shares.size()) {
      return a.info.shares.size() > b.info.shares.size();
    }
    return a.info.shares < b.info.shares;
  });
  CombinedPartials combined;
  std::vector<Partial> used;
  for (Partial& partial : partials) {
    if (!used.empty()) {
      const std::string difference = Difference(used.front().info, partial.info);
      if (!difference.empty()) {
        return Fail(ErrorCode::kInvalidArgument,
                    Name(used.front()) + " and " + Name(partial) + " differ in " + difference);
      }
    }
    const auto holds = [&](const Partial& other) { return Holds(other, partial); };
    if (std::any_of(used.begin(), used.end(), holds)) {
      combined.left_out.push_back(Name(partial));
      continue;
    }
    for (const Partial& other : used) {
      if (!Overlap(other, partial)) continue;
      return Fail(ErrorCode::kInvalidArgument,
                  Name(other) + " and " + Name(partial) +
                      " share some triangles but not all: their areas can no longer be told apart");
    }
    used.push_back(std::move(partial));
  }
  if (used.empty()) return Fail(ErrorCode::kInvalidArgument, "no partial was given");
  StoreLimits limits;
  limits.scratch = context.scratch();
  limits.context = &context;
  limits.barycentric = used.front().info.barycentric;
  combined.store = std::make_unique<ReservoirStore>(limits);
  for (Partial& partial : used) {
    if (combined.info.shares.empty()) {
      combined.info = partial.info;
    } else {
      Add(combined.info, partial.info);
    }
    combined.store->Adopt({partial.file, partial.run});
  }
  combined.parts = std::move(used);
  return combined;
}

Result<ScannedMesh> WholeOf(CombinedPartials combined) {
  const PartialInfo& info = combined.info;
  if (!info.complete()) {
    std::string missing;
    std::uint32_t listed = 0;
    for (std::uint32_t s = 0; s < info.share_count && listed < 20; ++s) {
      if (std::binary_search(info.shares.begin(), info.shares.end(), s)) continue;
      missing +=
          (listed++ == 0 ? "" : ", ") + std::to_string(s) + "/" + std::to_string(info.share_count);
    }
    return Fail(ErrorCode::kInvalidArgument, std::to_string(info.share_count - info.shares.size()) +
                                                 " of " + std::to_string(info.share_count) +
                                                 " shares are missing: " + missing);
  }
  if (info.sampled == 0) return Fail(ErrorCode::kEmptySurface, "no triangle of positive area");
  ScannedMesh scanned;
  SampleStats& stats = scanned.stats;
  stats.read = info.read;
  stats.skipped = info.skipped;
  stats.sampled = info.sampled;
  stats.bounds = info.bounds;
  stats.mesh_area = info.mesh_area;
  stats.lattice = info.lattice;
  stats.surface_hash = HexOf(info.surface);
  stats.pieces = info.pieces;
  scanned.surface = info.surface;
  scanned.store = std::move(combined.store);
  return scanned;
}

}  // namespace strata
