#include "core/uniform_arrivals.h"

#include <algorithm>
#include <cmath>

#include "core/numeric.h"
#include "core/random_stream.h"
#include "core/triangle_hash.h"

namespace strata {
namespace {

// Apart from the race's numbers with the same seed: the two methods' samples are independent.
constexpr std::uint64_t kUniformKey = 0x1f83d9abfb41bd6bULL;
constexpr int kNumberBits = 20;  // Of an arrival within its window.
// Lifts a product of time and area above its own rounding and that of an arrival's time.
constexpr double kAboveTime = 1 + 1e-14, kBelowTime = 1 - 1e-14;

using Block = r123::Philox4x32::ctr_type;

// Each arrival has two blocks: one for its time, one for its place.
Block BlockOf(std::uint64_t seed, std::uint64_t hash, std::uint64_t number, bool place) {
  const std::uint64_t key = seed + kUniformKey, low = number << 1 | (place ? 1 : 0);
  const Block counter{{static_cast<std::uint32_t>(hash), static_cast<std::uint32_t>(hash >> 32),
                       static_cast<std::uint32_t>(low), static_cast<std::uint32_t>(low >> 32)}};
  return r123::Philox4x32{}(
      counter, {{static_cast<std::uint32_t>(key), static_cast<std::uint32_t>(key >> 32)}});
}

double UniformOfTime(std::uint64_t seed, std::uint64_t hash, std::uint64_t number) {
  const Block block = BlockOf(seed, hash, number, false);
  return UniformFrom(block[0], block[1]);
}

// -0 and +0 are the same number: they must not differ in what is computed from them.
Vec3 WithoutNegativeZero(Vec3 p) { return {p.x + 0.0, p.y + 0.0, p.z + 0.0}; }

}  // namespace

std::optional<TriangleArrivals> TriangleArrivals::Of(const TriangleBatch& batch, std::size_t i) {
  std::array<Vec3, 3> corner;
  std::array<std::uint64_t, 3> hash;
  for (int v = 0; v < 3; ++v) {
    const auto k = static_cast<std::size_t>(v);
    corner[k] = WithoutNegativeZero(batch.corner(i, v));
    hash[k] = HashVertex(corner[k]);
  }
  TriangleArrivals t;
  t.first_ = CanonicalFirst(hash[0], hash[1], hash[2]);
  for (int v = 0; v < 3; ++v) {
    t.corner_[static_cast<std::size_t>(v)] = corner[static_cast<std::size_t>((t.first_ + v) % 3)];
  }
  t.area_vector_ = Cross(t.corner_[1] - t.corner_[0], t.corner_[2] - t.corner_[0]);
  if (!IsUsable(t.area_vector_)) return std::nullopt;
  t.area_ = 0.5 * Norm(t.area_vector_);
  t.hash_ = HashTriangle(hash[0], hash[1], hash[2]);
  t.id_ = batch.ids()[i];
  return t;
}

std::uint64_t TriangleArrivals::WindowsUntil(double end) const {
  return static_cast<std::uint64_t>(end * area_ * kAboveTime / kWindow) + 1;
}

std::uint64_t TriangleArrivals::WindowAt(double begin) const {
  return static_cast<std::uint64_t>(begin * area_ * kBelowTime / kWindow);
}

bool TriangleArrivals::IsQuietUntil(std::uint64_t seed, double end) const {
  // -ln(1 - u) >= u.
  return UniformOfTime(seed, hash_, 0) > end * area_ * kAboveTime;
}

void TriangleArrivals::Visit(std::uint64_t seed, std::uint64_t first, std::uint64_t last,
                             double begin, double end,
                             const std::function<void(const UniformArrival&)>& visit) const {
  for (std::uint64_t window = first; window < last; ++window) {
    const double start = static_cast<double>(window) * kWindow;
    double passed = 0;
    for (std::uint64_t number = window << kNumberBits;; ++number) {
      passed += NegLogOneMinus(UniformOfTime(seed, hash_, number));
      if (passed >= kWindow) break;
      const double time = (start + passed) / area_;
      if (time >= end) return;
      if (time >= begin) visit(At(seed, number, time));
    }
  }
}

UniformArrival TriangleArrivals::At(std::uint64_t seed, std::uint64_t number, double time) const {
  const Block block = BlockOf(seed, hash_, number, true);
  double u = UniformFrom(block[0], block[1]), v = UniformFrom(block[2], block[3]);
  if (u + v > 1) u = 1 - u, v = 1 - v;  // The parallelogram's other half.
  const auto& [a, b, c] = corner_;
  const Vec3 p = a + ((b - a) * u + (c - a) * v);
  UniformArrival arrival;
  arrival.time = time;
  arrival.hash = hash_;
  arrival.number = number;
  arrival.triangle = id_;
  for (int k = 0; k < 3; ++k) {  // Rounding may not leave the triangle's box.
    arrival.position[k] =
        std::clamp(p[k], std::min({a[k], b[k], c[k]}), std::max({a[k], b[k], c[k]}));
  }
  const std::array<double, 3> weight = {(1 - u) - v, u, v};
  for (int corner = 1; corner <= 2; ++corner) {  // Of the file's order.
    arrival.barycentric[corner - 1] = weight[static_cast<std::size_t>((corner - first_ + 3) % 3)];
  }
  const double scale = 1 / (2 * area_);
  const Vec3 n = area_vector_ * scale;
  arrival.normal = {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)};
  return arrival;
}

}  // namespace strata
