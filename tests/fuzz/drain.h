// Reading a whole mesh with bounded work: what every fuzz target does with what it opened.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/memory_account.h"
#include "core/mesh_attributes.h"
#include "core/mesh_reader.h"
#include "core/run_context.h"
#include "io/open_mesh.h"

namespace strata::test {

/// Aborts unless `holds`: a fuzz target's assertion, in every build.
inline void Require(bool holds) {
  if (!holds) std::abort();
}

/// What a fuzz target wants to know of a mesh, to compare two ways of reading it.
struct Drained {
  std::vector<std::uint64_t> some;  ///< Ids of the first that were delivered.
  bool failed = false;
  std::uint64_t triangles = 0;  ///< Delivered in batches.
  double sum = 0;               ///< Of all finite coordinates, in order.
  ReadCounts counts;
};

/// Reads to the end, an error or some million triangles, and checks what every reader promises:
/// sizes within the batch, ids that increase and lie below counts().triangles, and that at the end
/// every triangle was either delivered or counted as skipped.
inline Drained Drain(MeshReader& reader, std::size_t batch_size) {
  constexpr std::uint64_t kEnough = 1'000'000;
  Drained drained;
  TriangleBatch batch(batch_size);
  std::uint64_t next_id = 0;
  while (drained.triangles < kEnough) {
    auto n = reader.Read(batch);
    if (!n) {
      Require(!n.error().message.empty() && n.error().code != ErrorCode::kInternal);
      drained.failed = true;
      break;
    }
    Require(*n == batch.size() && *n <= batch.capacity());
    for (std::size_t i = 0; i < *n; ++i) {
      Require(batch.ids()[i] >= next_id);
      next_id = batch.ids()[i] + 1;
      if (drained.some.size() < 300) drained.some.push_back(batch.ids()[i]);
      for (int k = 0; k < 9; ++k) {
        const double value = batch.column(k)[i];
        if (value - value == 0) drained.sum += value;
      }
    }
    drained.triangles += *n;
    Require(next_id <= reader.counts().triangles);
    if (*n == 0) break;
  }
  drained.counts = reader.counts();
  if (!drained.failed && drained.triangles < kEnough) {
    std::uint64_t skipped = 0;
    for (const std::uint64_t count : drained.counts.skipped) skipped += count;
    Require(drained.triangles + skipped == drained.counts.triangles);
  }
  return drained;
}

/// Fetches every attribute that is at hand of points on these triangles, a few at a time. That
/// there is something wrong with attributes is an answer too.
inline void FetchAttributes(MeshReader& reader, std::span<const std::uint64_t> triangles) {
  constexpr std::size_t kAtOnce = 37;
  RunContext context(std::uint64_t{64} << 20);
  std::vector<std::size_t> all;
  for (std::size_t k = 0; k < reader.attributes().size(); ++k) {
    if (reader.CheckAttribute(k, CheckDepth::kHeads, context)) all.push_back(k);
  }
  if (all.empty()) return;
  const auto pass = reader.ReadAttributes(all, context);
  const auto is_answer = [](const Error& error) {
    return !error.message.empty() && error.code != ErrorCode::kInternal;
  };
  if (!pass) return Require(is_answer(pass.error()));
  std::vector<std::vector<char>> values;
  std::vector<char*> out;
  for (const std::size_t k : all) {
    const MeshAttribute& attribute = reader.attributes()[k];
    Require(attribute.components >= 1 && attribute.components <= kMostComponents);
    values.emplace_back(kAtOnce * attribute.bytes());
    out.push_back(values.back().data());
  }
  for (std::size_t first = 0; first < triangles.size(); first += kAtOnce) {
    std::vector<SurfacePoint> points;
    for (std::size_t i = first; i < std::min(first + kAtOnce, triangles.size()); ++i) {
      points.push_back({triangles[i], {0.5, 0.25, 0.25}});
    }
    if (const auto read = (*pass)->Read(points, out); !read) {
      return Require(is_answer(read.error()));
    }
  }
}

/// Drains a reader twice, in batches of different sizes with Rewind between, and requires that both
/// passes agree, and fetches attributes between. An error to open is an answer too. `reader` may be
/// taken apart.
inline void DrainTwice(Result<std::unique_ptr<MeshReader>> reader) {
  if (!reader) {
    Require(!reader.error().message.empty() && reader.error().code != ErrorCode::kInternal);
    return;
  }
  const Drained first = Drain(**reader, 64);
  if (first.failed) return;
  FetchAttributes(**reader, first.some);
  Require((*reader)->Rewind().has_value());
  const Drained second = Drain(**reader, 7);
  Require(!second.failed && second.counts.triangles == first.counts.triangles);
  Require(second.sum == first.sum || first.sum - first.sum != 0);
}

/// DrainTwice of what `open(bytes, options)` makes of a fuzzer's bytes, in 256 MiB.
template <class Open>
int DrainBounded(const std::uint8_t* data, std::size_t size, const Open& open) {
  MemoryAccount memory(std::uint64_t{256} << 20);
  io::OpenOptions options;
  options.memory = &memory;
  DrainTwice(open(std::string(reinterpret_cast<const char*>(data), size), options));
  return 0;
}

}  // namespace strata::test
