// Integrals over the surface, estimated from areas: the areas add up to the mesh's, and the sum of
// area times function has the integral as its mean and less variance than uniform samples.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <functional>
#include <numeric>
#include <string>

#include "core/sample_mesh.h"
#include "io/open_mesh.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/test_data.h"

namespace strata::test {
namespace {

// The bunny, or the repository's own mesh where the collection is not there; scaled to length one.
Triangles Model() {
  const auto bunny = TestDataFolder(STRATA_SOURCE_DIR) / "scans/bun_zipper.ply";
  const std::string path = std::filesystem::exists(bunny)
                               ? bunny.string()
                               : std::string(STRATA_SOURCE_DIR) + "/models/spot.obj";
  auto reader = io::OpenMesh(path);
  EXPECT_TRUE(reader) << path;
  Triangles mesh = ReadTriangles(**reader);
  Bounds box;
  for (const Triangle& t : mesh) {
    for (const Vec3& c : t) box.Add(c);
  }
  const Vec3 side = box.max - box.min;
  const double scale = 1 / std::max({side.x, side.y, side.z});
  for (Triangle& t : mesh) {
    for (Vec3& c : t) c = (c - box.min) * scale;
  }
  return mesh;
}

double AreaOf(const Triangle& t) { return 0.5 * Norm(Cross(t[1] - t[0], t[2] - t[0])); }

struct Function {
  const char* name;
  std::function<double(Vec3)> of;
};

const std::array<Function, 5>& Functions() {
  static const std::array<Function, 5> functions = {{
      {"x", [](Vec3 p) { return p.x; }},
      {"y * z", [](Vec3 p) { return p.y * p.z; }},
      {"x^2 + y^3", [](Vec3 p) { return p.x * p.x + p.y * p.y * p.y; }},
      {"sin(7 x) cos(5 y)", [](Vec3 p) { return std::sin(7 * p.x) * std::cos(5 * p.y); }},
      {"exp(-4 |p - c|^2)",
       [](Vec3 p) {
         return std::exp(-4 * Norm2(p - Vec3{0.5, 0.5, 0.4}));
       }},
  }};
  return functions;
}

// By Strang's rule of seven points and degree five on each triangle, cut into four twice.
double Integral(const Triangle& t, const Function& f, int cuts) {
  if (cuts > 0) {
    const Vec3 a = (t[0] + t[1]) * 0.5, b = (t[1] + t[2]) * 0.5, c = (t[2] + t[0]) * 0.5;
    return Integral({t[0], a, c}, f, cuts - 1) + Integral({a, t[1], b}, f, cuts - 1) +
           Integral({c, b, t[2]}, f, cuts - 1) + Integral({a, b, c}, f, cuts - 1);
  }
  const double r = std::sqrt(15.0);
  const double p = (6 - r) / 21, q = (6 + r) / 21, wp = (155 - r) / 1200, wq = (155 + r) / 1200;
  const auto at = [&](double u, double v) {
    return f.of(t[0] * (1 - u - v) + t[1] * u + t[2] * v);
  };
  const double sum = 9.0 / 40 * at(1.0 / 3, 1.0 / 3) +
                     wp * (at(p, p) + at(p, 1 - 2 * p) + at(1 - 2 * p, p)) +
                     wq * (at(q, q) + at(q, 1 - 2 * q) + at(1 - 2 * q, q));
  return sum * AreaOf(t);
}

std::array<double, 5> Integrals(const Triangles& mesh) {
  std::array<double, 5> sums{};
  for (const Triangle& t : mesh) {
    for (std::size_t k = 0; k < 5; ++k) sums[k] += Integral(t, Functions()[k], 1);
  }
  return sums;
}

SampleResult Sample(const Triangles& mesh, SampleOptions options) {
  options.attributes = kArea | kWeight;
  options.lattice = Resolution{24};
  MemoryMesh reader(mesh);
  RunContext context;
  auto result = SampleMesh(reader, options, context);
  EXPECT_TRUE(result) << result.error().message;
  return result ? std::move(*result) : SampleResult();
}

struct Spread {
  double mean = 0, variance = 0;
};

Spread SpreadOf(const std::vector<double>& values) {
  const double n = static_cast<double>(values.size());
  Spread s;
  s.mean = std::accumulate(values.begin(), values.end(), 0.0) / n;
  for (const double v : values) s.variance += (v - s.mean) * (v - s.mean) / (n - 1);
  return s;
}

constexpr int kSeeds = 200;

// The estimates of all integrals over 200 seeds.
std::array<Spread, 5> Estimates(const Triangles& mesh, SampleOptions options) {
  std::array<std::vector<double>, 5> values;
  for (int seed = 0; seed < kSeeds; ++seed) {
    options.seed = static_cast<std::uint64_t>(seed);
    const SampleColumns samples = Sample(mesh, options).samples;
    for (std::size_t k = 0; k < 5; ++k) {
      double sum = 0;
      for (std::size_t i = 0; i < samples.size(); ++i) {
        sum += samples.area[i] * Functions()[k].of(samples.position[i]);
      }
      values[k].push_back(sum);
    }
  }
  std::array<Spread, 5> spreads;
  for (std::size_t k = 0; k < 5; ++k) spreads[k] = SpreadOf(values[k]);
  return spreads;
}

TEST(Areas, AddUpToTheMeshsWhateverTheMinimumDistance) {
  const Triangles mesh = Model();
  double area = 0;
  for (const Triangle& t : mesh) area += AreaOf(t);
  for (const double m : {0.0, 0.5, 0.9, 2.0, 4.0}) {
    for (const double lambda : {0.0, 5.0}) {
      SampleOptions options;
      options.min_distance = m;
      options.lambda = lambda;
      const SampleResult result = Sample(mesh, options);
      if (m > 0.5) {
        EXPECT_LT(result.stats.survivors, result.stats.cells);
      }
      const auto& areas = result.samples.area;
      const double sum = std::accumulate(areas.begin(), areas.end(), 0.0);
      EXPECT_NEAR(sum / area, 1, 1e-9) << "m " << m << ", lambda " << lambda;
    }
  }
}

TEST(Areas, EstimateIntegralsWithoutBiasAndWithLessVarianceThanUniformSamples) {
  const Triangles mesh = Model();
  const auto exact = Integrals(mesh);
  SampleOptions stratified;
  stratified.lambda = stratified.min_distance = 0;
  SampleOptions uniform;
  uniform.method = Method::kUniform;
  uniform.count = Sample(mesh, stratified).stats.survivors;
  const auto ours = Estimates(mesh, stratified), theirs = Estimates(mesh, uniform);
  for (std::size_t k = 0; k < 5; ++k) {
    const double error = std::sqrt(ours[k].variance / kSeeds);
    std::printf("%-18s exact %.9f  bias %+5.2f sigma  variance %.2e of uniform's (%llu samples)\n",
                Functions()[k].name, exact[k], (ours[k].mean - exact[k]) / error,
                ours[k].variance / theirs[k].variance,
                static_cast<unsigned long long>(uniform.count));
    EXPECT_NEAR(ours[k].mean, exact[k], 4 * error) << Functions()[k].name << ": 4 sigma";
    EXPECT_LT(ours[k].variance, 0.1 * theirs[k].variance) << Functions()[k].name;
  }
}

// With the defaults samples keep to the middle of their cells, and survivors speak for their
// neighbours: a bias remains, which is smaller than uniform sampling's deviation.
TEST(Areas, OfTheDefaultOptionsAreOffByLessThanUniformSamplesVary) {
  const Triangles mesh = Model();
  const auto exact = Integrals(mesh);
  const SampleOptions defaults;
  SampleOptions uniform;
  uniform.method = Method::kUniform;
  uniform.count = Sample(mesh, defaults).stats.survivors;
  const auto ours = Estimates(mesh, defaults), theirs = Estimates(mesh, uniform);
  for (std::size_t k = 0; k < 5; ++k) {
    const double bias = ours[k].mean - exact[k];
    std::printf("%-18s exact %.9f  bias %.1e of it, mean square error %.2e of uniform's\n",
                Functions()[k].name, exact[k], bias / exact[k],
                (ours[k].variance + bias * bias) / theirs[k].variance);
    EXPECT_LT(ours[k].variance + bias * bias, theirs[k].variance) << Functions()[k].name;
  }
}

TEST(Weight, IsTheDensityAtTheSample) {
  SampleOptions options;
  options.attributes = kWeight | kCell;
  options.lattice = VoxelSize{0.25};
  options.lambda = 3;
  MemoryMesh reader(BoxMesh({0.1, 0.1, 0.1}, {1.7, 1.9, 2.3}));
  RunContext context;
  const auto result = SampleMesh(reader, options, context);
  ASSERT_TRUE(result);
  const SampleColumns& s = result->samples;
  ASSERT_GT(s.size(), 50u);
  for (std::size_t i = 0; i < s.size(); ++i) {
    const Vec3 center = Vec3{s.cell[i].x + 0.5, s.cell[i].y + 0.5, s.cell[i].z + 0.5} * 0.25;
    EXPECT_NEAR(s.weight[i], std::exp(-3 * Norm(s.position[i] - center) / 0.25), 1e-9);
  }
}

}  // namespace
}  // namespace strata::test
