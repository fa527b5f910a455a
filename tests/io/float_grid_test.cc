#include "io/float_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "tests/support/sample_columns.h"

namespace strata::io {
namespace {

using test::MessageOf;

// What a quantiser that works in float32 does, both ways.
float ThroughFloatQuantizer(float value, float origin, float range, int bits) {
  const auto last = static_cast<float>((1 << bits) - 1);
  const float inverse = last / range, step = range / last;
  const float scaled = (value - origin) * inverse;
  const float rounded = scaled + 0.5f;
  const auto q = static_cast<std::int32_t>(std::floor(rounded));
  EXPECT_GE(q, 0);
  EXPECT_LT(q, 1 << bits);
  const float product = static_cast<float>(q) * step;
  return product + origin;
}

Bounds BoxOf(Vec3 corner, Vec3 extent) {
  Bounds box;
  box.Add(corner);
  box.Add(corner + extent);
  return box;
}

Vec3 PointIn(const Bounds& box, std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0, 1);
  Vec3 p;
  for (int a = 0; a < 3; ++a) {
    const double t = unit(random);
    // The ends often, because rounding bites there.
    p[a] = t < 0.1   ? box.min[a]
           : t > 0.9 ? box.max[a]
                     : std::min(box.max[a], box.min[a] + (box.max[a] - box.min[a]) * unit(random));
  }
  return p;
}

// Every bound of the header, checked on points of the box.
void ExpectKept(const Bounds& box, double max_error, std::mt19937_64& random) {
  const auto grid = ChooseFloatGrid(box, max_error, "test");
  ASSERT_TRUE(grid) << MessageOf(grid);
  const auto range = static_cast<float>(grid->range());
  ASSERT_EQ(range, grid->range());
  for (int i = 0; i < 200; ++i) {
    const Vec3 p = PointIn(box, random);
    const auto q = grid->Quantize(p);
    const auto value = grid->ValueAt(q);
    double squared = 0;
    for (int a = 0; a < 3; ++a) {
      const auto k = static_cast<std::size_t>(a);
      const float back =
          ThroughFloatQuantizer(value[k], static_cast<float>(grid->origin[a]), range, grid->bits);
      ASSERT_EQ(back, value[k]) << "q " << q[k] << " bits " << grid->bits << " step " << grid->step;
      const double error = grid->offset[a] + static_cast<double>(back) - p[a];
      squared += error * error;
    }
    ASSERT_LE(std::sqrt(squared), max_error) << "step " << grid->step << " bits " << grid->bits;
  }
}

TEST(FloatGrid, MovesNoPointFurtherThanAllowed) {
  const std::uint64_t seed = 20;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  for (int trial = 0; trial < 2000; ++trial) {
    const double edge = std::ldexp(1 + unit(random), static_cast<int>(unit(random) * 120) - 60);
    const double cells = std::exp(unit(random) * std::log(30'000.0));
    const double away = trial % 3 == 0 ? 0 : trial % 3 == 1 ? cells : 1e7;
    const Vec3 corner = Vec3{unit(random) - 0.5, unit(random) - 0.5, unit(random)} * (away * edge);
    // Flat along an axis, or a single point, now and then.
    const Vec3 extent =
        Vec3{cells, trial % 5 == 0 ? 0 : cells * unit(random), trial % 7 == 0 ? 0 : cells / 2} *
        (trial % 35 == 0 ? 0 : edge);
    SCOPED_TRACE("trial " + std::to_string(trial));
    ExpectKept(BoxOf(corner, extent), edge * (trial % 4 == 0 ? unit(random) + 0.01 : 0.01), random);
    if (HasFatalFailure()) return;
  }
}

TEST(FloatGrid, KeepsWorldCoordinatesWhereFloat32HoldsThem) {
  const auto near = ChooseFloatGrid(BoxOf({-3, 5, 100}, {50, 60, 70}), 0.01, "test");
  ASSERT_TRUE(near) << MessageOf(near);
  EXPECT_EQ(near->offset, Vec3{});
  EXPECT_EQ(near->bits, 13);
  EXPECT_NEAR(near->step, 0.02 / std::sqrt(3.0), 0.02 * 0.02) << "close to the largest possible";
  const auto far = ChooseFloatGrid(BoxOf({4e5, 5e6, 100}, {50, 60, 70}), 1e-4, "test");
  ASSERT_TRUE(far) << MessageOf(far);
  EXPECT_EQ(far->origin, Vec3{});
  EXPECT_NEAR(far->offset.y, 5e6, 1);
}

TEST(FloatGrid, RefusesTheImpossibleAndNamesWhatIsPossible) {
  std::mt19937_64 random(3);
  const Bounds boxes[] = {BoxOf({0, 0, 0}, {1, 1, 1}), BoxOf({1e12, 0, 0}, {1e3, 0, 5}),
                          BoxOf({3, 3, 3}, {0, 0, 0}), BoxOf({-7, 0, 0}, {1e9, 1e9, 1})};
  for (const Bounds& box : boxes) {
    for (const double error : {0.0, -1.0, std::nan(""), 1e-40}) {
      const auto refused = ChooseFloatGrid(box, error, "a.drc");
      ASSERT_FALSE(refused);
      EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
      const std::string& message = refused.error().message;
      EXPECT_TRUE(message.starts_with("a.drc: ")) << message;
      const double possible = std::stod(message.substr(message.rfind(' ')));
      SCOPED_TRACE(message);
      ExpectKept(box, possible, random);
      EXPECT_FALSE(ChooseFloatGrid(box, possible / 2.1, "a.drc")) << "smallest, says the message";
    }
  }
}

TEST(FloatGrid, RefusesBoxesThatAreEmptyOrNotFinite) {
  Bounds infinite;
  infinite.Add({HUGE_VAL, 0, 0});
  for (const Bounds& box : {Bounds{}, infinite, BoxOf({-1e308, 0, 0}, {1.7e308, 0, 0})}) {
    EXPECT_FALSE(ChooseFloatGrid(box, 1, "test"));
  }
}

TEST(TileLattice, HasAGridForEveryBoxWithinTheWhole) {
  std::mt19937_64 random(23);
  const auto unit = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  for (int round = 0; round < 300; ++round) {
    const double side = std::pow(10, 12 * unit() - 6), far = side * std::pow(10, 6 * unit() - 3);
    const Bounds whole{{far, -far, far / 3}, {far + side, side - far, far / 3 + side * unit()}};
    const double error = side * std::pow(10, -7 * unit());
    const auto lattice = ChooseTileLattice(whole, error, "a");
    ASSERT_TRUE(lattice) << "seed 23, round " << round << ": " << lattice.error().message;
    const double most = LargestGridStep(whole, error);
    EXPECT_GE(lattice->step, most / 2);
    EXPECT_LE(lattice->step, most);
    for (int n = 0; n < 20; ++n) {
      Bounds box;
      for (int a = 0; a < 3; ++a) {
        const double extent = whole.max[a] - whole.min[a];
        const double width = std::min(extent, kMostTileSteps * most) * (n == 0 ? 1 : unit());
        box.min[a] = whole.min[a] + (extent - width) * unit();
        box.max[a] = std::min(box.min[a] + width, whole.max[a]);
      }
      const auto grid = TileGrid(*lattice, box, "a");
      ASSERT_TRUE(grid) << "seed 23, round " << round << ": " << grid.error().message;
      EXPECT_EQ(grid->step, lattice->step);
    }
  }
}

}  // namespace
}  // namespace strata::io
