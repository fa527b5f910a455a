#include "io/vertex_array.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

namespace strata::io {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

TEST(VertexArray, HoldsFloatsWhileEveryCoordinateIsOne) {
  VertexArray vertices;
  for (int i = 0; i < 1000; ++i) vertices.Append(i * 0.5, -i, 1.0f / 3.0f);
  vertices.Append(std::nan(""), kInf, -kInf);
  EXPECT_FALSE(vertices.is_double());
  ASSERT_EQ(vertices.size(), 1001u);
  EXPECT_EQ(vertices.view().f64.size(), 0u);
  EXPECT_EQ(vertices.view()[999], (Vec3{499.5, -999, 1.0f / 3.0f}));
  EXPECT_TRUE(std::isnan(vertices.view()[1000].x));
  EXPECT_EQ(vertices.view()[1000].z, -kInf);
}

TEST(VertexArray, TurnsIntoDoublesAtTheFirstCoordinateThatIsNotAFloat) {
  for (const double value : {0.1, 1e300, -1e-300, 364512.261, 16777217.0}) {
    VertexArray vertices;
    vertices.Append(1, 2, 3);
    vertices.Append(1, 2, value);
    vertices.Append(4, 5, 6);
    EXPECT_TRUE(vertices.is_double()) << value;
    ASSERT_EQ(vertices.size(), 3u);
    EXPECT_EQ(vertices.view().f32.size(), 0u);
    EXPECT_EQ(vertices.view()[0], (Vec3{1, 2, 3}));
    EXPECT_EQ(vertices.view()[1], (Vec3{1, 2, value}));
    EXPECT_EQ(vertices.view()[2], (Vec3{4, 5, 6}));
  }
}

TEST(VertexArray, TakesNumbersInBulk) {
  VertexArray vertices;
  std::span<float> room = vertices.ExtendFloat(2);
  ASSERT_EQ(room.size(), 6u);
  for (std::size_t i = 0; i < 6; ++i) room[i] = static_cast<float>(i);
  vertices.AppendFloats(std::array{6.f, 7.f, 8.f});
  vertices.AppendDoubles(std::array{9., 10., 11.});
  EXPECT_FALSE(vertices.is_double());
  vertices.AppendDoubles(std::array{12., 13.1, 14.});
  vertices.AppendFloats(std::array{15.f, 16.f, 17.f});
  EXPECT_TRUE(vertices.is_double());
  ASSERT_EQ(vertices.size(), 6u);
  EXPECT_EQ(vertices.view()[0], (Vec3{0, 1, 2}));
  EXPECT_EQ(vertices.view()[3], (Vec3{9, 10, 11}));
  EXPECT_EQ(vertices.view()[4], (Vec3{12, 13.1, 14}));
  EXPECT_EQ(vertices.view()[5], (Vec3{15, 16, 17}));
}

TEST(VertexArray, KeepsTheSignOfZero) {
  VertexArray vertices;
  vertices.Append(-0.0, 0.0, 0.1);
  EXPECT_TRUE(std::signbit(vertices.view()[0].x));
  EXPECT_FALSE(std::signbit(vertices.view()[0].y));
}

}  // namespace
}  // namespace strata::io
