// Reading Draco files with Draco's own decoder, attributes found by their names as a user would.
#pragma once

#include <draco/compression/decode.h>
#include <gtest/gtest.h>

#include <array>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/samples.h"

namespace strata::test {

inline std::unique_ptr<draco::PointCloud> DecodeDraco(const std::string& bytes) {
  draco::DecoderBuffer buffer;
  buffer.Init(bytes.data(), bytes.size());
  draco::Decoder decoder;
  auto decoded = decoder.DecodePointCloudFromBuffer(&buffer);
  if (!decoded.ok()) {
    ADD_FAILURE() << decoded.status().error_msg();
    return nullptr;
  }
  return std::move(decoded).value();
}

template <class T, std::size_t N>
std::vector<std::array<T, N>> DracoColumn(const draco::PointCloud& cloud, const std::string& name) {
  std::vector<std::array<T, N>> values;
  const int id = cloud.GetAttributeIdByMetadataEntry("name", name);
  if (id < 0) {
    ADD_FAILURE() << "no attribute named " << name;
    return values;
  }
  const draco::PointAttribute& attribute = *cloud.attribute(id);
  EXPECT_EQ(attribute.num_components(), static_cast<int>(N)) << name;
  EXPECT_EQ(attribute.byte_stride(), static_cast<int>(sizeof(T) * N)) << name;
  for (draco::PointIndex i(0); i < cloud.num_points(); ++i) {
    std::array<T, N> value;
    attribute.GetMappedValue(i, value.data());
    values.push_back(value);
  }
  return values;
}

inline Vec3 DracoOffset(const draco::PointCloud& cloud) {
  Vec3 offset;
  EXPECT_TRUE(cloud.GetMetadata()->GetEntryDouble("position_offset_x", &offset.x));
  EXPECT_TRUE(cloud.GetMetadata()->GetEntryDouble("position_offset_y", &offset.y));
  EXPECT_TRUE(cloud.GetMetadata()->GetEntryDouble("position_offset_z", &offset.z));
  return offset;
}

/// A decoded file as samples: positions in the world, all the attributes in `attributes`.
inline SampleColumns DracoSamples(const draco::PointCloud& cloud, AttributeSet attributes) {
  SampleColumns s;
  const auto has = [&](Attribute a) { return (attributes & a) != 0; };
  const Vec3 offset = DracoOffset(cloud);
  for (const auto& p : DracoColumn<float, 3>(cloud, "position")) {
    s.position.push_back(offset + Vec3{p[0], p[1], p[2]});
  }
  if (has(kNormal)) {
    for (const auto& n : DracoColumn<float, 3>(cloud, "normal")) {
      s.normal.push_back({n[0], n[1], n[2]});
    }
  }
  if (has(kTriangle)) {
    for (const auto& words : DracoColumn<std::uint16_t, 4>(cloud, "triangle")) {
      std::uint64_t triangle;
      std::memcpy(&triangle, words.data(), sizeof triangle);
      s.triangle.push_back(triangle);
    }
  }
  if (has(kBarycentric)) {
    for (const auto& w : DracoColumn<float, 3>(cloud, "barycentric")) {
      s.barycentric.push_back({w[0], w[1], w[2]});
    }
  }
  if (has(kCell)) {
    const auto x = DracoColumn<std::int32_t, 1>(cloud, "cell_x");
    const auto y = DracoColumn<std::int32_t, 1>(cloud, "cell_y");
    const auto z = DracoColumn<std::int32_t, 1>(cloud, "cell_z");
    for (std::size_t i = 0; i < x.size(); ++i) s.cell.push_back({x[i][0], y[i][0], z[i][0]});
  }
  if (has(kArea)) {
    for (const auto& a : DracoColumn<float, 1>(cloud, "area")) s.area.push_back(a[0]);
  }
  if (has(kWeight)) {
    for (const auto& w : DracoColumn<float, 1>(cloud, "weight")) s.weight.push_back(w[0]);
  }
  return s;
}

}  // namespace strata::test
