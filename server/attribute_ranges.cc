#include "server/attribute_ranges.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <span>

namespace strata::server {
namespace {

constexpr std::size_t kBatch = 2048;

template <class T>
void Widen(const std::vector<char>& bytes, std::size_t n, AttributeRange& range) {
  const auto components = static_cast<std::size_t>(range.attribute.components);
  for (std::size_t i = 0; i < n * components; ++i) {
    T value;
    std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
    const auto number = static_cast<double>(value);
    double& min = range.min[i % components];
    double& max = range.max[i % components];
    if (number < min) min = number;
    if (number > max) max = number;
  }
}

void Add(const std::vector<char>& bytes, std::size_t n, AttributeRange& range) {
  WithType(range.attribute.type, [&](auto zero) { Widen<decltype(zero)>(bytes, n, range); });
}

}  // namespace

Result<std::vector<AttributeRange>> FindRanges(MeshReader& triangles, MeshReader& values,
                                               RunContext& context) {
  constexpr double kInfinite = std::numeric_limits<double>::infinity();
  std::vector<AttributeRange> ranges;
  std::vector<std::vector<char>> buffers;
  std::vector<char*> out;
  for (const MeshAttribute& attribute : values.attributes()) {
    const auto components = static_cast<std::size_t>(attribute.components);
    ranges.push_back({attribute, std::vector<double>(components, kInfinite),
                      std::vector<double>(components, -kInfinite), ""});
    buffers.emplace_back(3 * kBatch * attribute.bytes());
  }
  // What corners have: an image's colours lie between them.
  std::vector<std::size_t> all;
  for (std::size_t k = 0; k < ranges.size(); ++k) {
    if (ranges[k].attribute.carry != Carry::kLookedUp) all.push_back(k);
  }
  for (const std::size_t k : all) out.push_back(buffers[k].data());
  auto pass = values.ReadAttributes(all, context);
  if (!pass) return Forward(pass);
  TriangleBatch batch(kBatch);
  std::vector<SurfacePoint> corners;
  for (;;) {
    if (context.cancelled()) return Cancelled();
    const auto n = triangles.Read(batch);
    if (!n) return Forward(n);
    if (*n == 0) break;
    corners.clear();
    for (std::size_t i = 0; i < *n; ++i) {
      for (std::size_t k = 0; k < 3; ++k) {
        corners.push_back({batch.ids()[i], {}});
        corners.back().weight[k] = 1;
      }
    }
    if (auto ok = (*pass)->Read(corners, out); !ok) return Forward(ok);
    for (const std::size_t k : all) Add(buffers[k], corners.size(), ranges[k]);
  }
  for (AttributeRange& range : ranges) {
    if (range.min.empty() || range.min[0] <= range.max[0]) continue;
    range.min.clear();
    range.max.clear();
  }
  return ranges;
}

}  // namespace strata::server
