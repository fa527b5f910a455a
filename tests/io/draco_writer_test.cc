// Reads back with Draco's own decoder.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <random>

#include "io/sample_writer.h"
#include "tests/support/read_draco.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::DecodeDraco;
using test::DracoColumn;
using test::DracoOffset;
using test::HeaderFor;
using test::kProvenance;
using test::MessageOf;
using test::RandomSamples;
using test::ReadFile;
using test::TempFolder;
using test::WriteSamples;

// The furthest that a decoded position lies from its sample.
double WorstError(const draco::PointCloud& cloud, const SampleColumns& samples) {
  const auto positions = DracoColumn<float, 3>(cloud, "position");
  const Vec3 offset = DracoOffset(cloud);
  EXPECT_EQ(positions.size(), samples.size());
  double worst = 0;
  for (std::size_t i = 0; i < positions.size(); ++i) {
    const auto& p = positions[i];
    worst = std::max(worst, Norm(offset + Vec3{p[0], p[1], p[2]} - samples.position[i]));
  }
  return worst;
}

std::unique_ptr<draco::PointCloud> WriteAndDecode(const SampleColumns& samples,
                                                  const SampleHeader& header) {
  TempFolder folder;
  const auto size = WriteSamples(folder / "a.drc", SampleFormat::kDraco, samples, header);
  if (!size) {
    ADD_FAILURE() << MessageOf(size);
    return nullptr;
  }
  return DecodeDraco(ReadFile(folder / "a.drc"));
}

TEST(DracoWriter, KeepsEveryBitOfTheIntegersAndTheOrder) {
  SampleColumns samples = RandomSamples(3000, 31);
  samples.triangle[0] = ~std::uint64_t{0};
  samples.triangle[1] = 0x8000'0000;
  samples.triangle[2] = 0;
  for (Cell& cell : samples.cell) cell.z += (1 << 30);  // Axes far from each other.
  const auto cloud = WriteAndDecode(samples, HeaderFor(samples, kAllAttributes));
  ASSERT_NE(cloud, nullptr);
  const auto triangles = DracoColumn<std::uint16_t, 4>(*cloud, "triangle");
  const auto x = DracoColumn<std::int32_t, 1>(*cloud, "cell_x");
  const auto y = DracoColumn<std::int32_t, 1>(*cloud, "cell_y");
  const auto z = DracoColumn<std::int32_t, 1>(*cloud, "cell_z");
  const auto area = DracoColumn<float, 1>(*cloud, "area");
  ASSERT_EQ(triangles.size(), samples.size());
  for (std::size_t i = 0; i < samples.size(); ++i) {
    std::uint64_t triangle;
    memcpy(&triangle, triangles[i].data(), sizeof triangle);
    ASSERT_EQ(triangle, samples.triangle[i]) << "sample " << i;
    ASSERT_EQ((Cell{x[i][0], y[i][0], z[i][0]}), samples.cell[i]) << "sample " << i;
    ASSERT_EQ(area[i][0], static_cast<float>(samples.area[i])) << "sample " << i;
  }
}

TEST(DracoWriter, NamesItsAttributesAndCarriesItsProvenance) {
  const SampleColumns samples = RandomSamples(10, 31);
  const SampleHeader header = HeaderFor(samples, kAllAttributes);
  const auto cloud = WriteAndDecode(samples, header);
  ASSERT_NE(cloud, nullptr);
  std::vector<std::string> names;
  for (int id = 0; id < cloud->num_attributes(); ++id) {
    std::string name;
    ASSERT_NE(cloud->GetAttributeMetadataByAttributeId(id), nullptr);
    EXPECT_TRUE(cloud->GetAttributeMetadataByAttributeId(id)->GetEntryString("name", &name));
    names.push_back(name);
  }
  EXPECT_EQ(names, (std::vector<std::string>{"position", "normal", "triangle", "barycentric",
                                             "cell_x", "cell_y", "cell_z", "area", "weight"}));
  const draco::GeometryMetadata& metadata = *cloud->GetMetadata();
  std::string provenance;
  EXPECT_TRUE(metadata.GetEntryString("strata", &provenance));
  EXPECT_EQ(provenance, kProvenance);
  double error = 0, edge = 0;
  EXPECT_TRUE(metadata.GetEntryDouble("position_error", &error));
  EXPECT_TRUE(metadata.GetEntryDouble("cell_edge", &edge));
  EXPECT_EQ(error, header.position_error);
  EXPECT_EQ(edge, header.edge);
  EXPECT_EQ(DracoOffset(*cloud), Vec3{});
}

TEST(DracoWriter, LeavesOutWhatWasNotAskedFor) {
  const SampleColumns samples = RandomSamples(10, 31);
  const auto cloud = WriteAndDecode(samples, HeaderFor(samples, 0));
  ASSERT_NE(cloud, nullptr);
  EXPECT_EQ(cloud->num_attributes(), 1);
}

TEST(DracoWriter, MovesNoPositionFurtherThanAllowed) {
  const std::uint64_t seed = 41;
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> unit(0, 1);
  for (int trial = 0; trial < 150; ++trial) {
    const double edge = std::ldexp(1 + unit(random), static_cast<int>(unit(random) * 80) - 40);
    const double away = trial % 3 == 0 ? 0 : trial % 3 == 1 ? 1000 : 1e7;
    const Vec3 corner = Vec3{unit(random) - 0.5, unit(random) - 0.5, unit(random)} * (away * edge);
    const std::size_t count = trial % 10 == 0 ? 1 : 300;
    SampleColumns samples = RandomSamples(count, random(), edge, corner, 1 + 5000 * unit(random));
    if (trial % 4 == 0) {
      for (Vec3& p : samples.position) p.y = corner.y;
    }
    const SampleHeader header = HeaderFor(samples, kNormal, edge);
    const auto cloud = WriteAndDecode(samples, header);
    ASSERT_NE(cloud, nullptr);
    ASSERT_EQ(cloud->num_points(), count);
    ASSERT_LE(WorstError(*cloud, samples), header.position_error)
        << "trial " << trial << " edge " << edge;
  }
}

TEST(DracoWriter, HoldsGeoReferencedCoordinatesThroughTheOffset) {
  const SampleColumns samples = RandomSamples(1000, 5, 0.01, {431'234.5, 5'412'345.25, 312.125});
  const SampleHeader header = HeaderFor(samples, kNormal, 0.01);
  const auto cloud = WriteAndDecode(samples, header);
  ASSERT_NE(cloud, nullptr);
  EXPECT_NE(DracoOffset(*cloud), Vec3{});
  EXPECT_LE(WorstError(*cloud, samples), header.position_error);
}

TEST(DracoWriter, RefusesAnErrorThatFloat32CannotReach) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(100, 5);
  SampleHeader header = HeaderFor(samples, kNormal);
  for (const double error : {0.0, 1e-12}) {
    header.position_error = error;
    const auto refused = WriteSamples(folder / "a.drc", SampleFormat::kDraco, samples, header);
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
    EXPECT_NE(refused.error().message.find("smallest possible is"), std::string::npos)
        << MessageOf(refused);
  }
  EXPECT_TRUE(folder.List().empty());
}

TEST(DracoWriter, RefusesMoreSamplesThanDracoCounts) {
  TempFolder folder;
  SampleHeader header = HeaderFor(RandomSamples(2, 5), kNormal);
  for (const std::uint64_t count :
       {std::uint64_t{1} << 29, std::uint64_t{1} << 31, ~std::uint64_t{0}}) {
    header.count = count;
    const auto refused = OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, header,
                                          {.tile_samples = ~std::uint64_t{0}});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  }
}

TEST(DracoWriter, RefusesASampleOutsideTheBounds) {
  TempFolder folder;
  SampleColumns samples = RandomSamples(100, 5);
  const SampleHeader header = HeaderFor(samples, kNormal);
  samples.position[50].x = header.bounds.max.x + 0.01;
  const auto refused = WriteSamples(folder / "a.drc", SampleFormat::kDraco, samples, header);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kInternal);
}

TEST(DracoWriter, RefusesCellsThatWouldMakeDracoAllocateGigabytes) {
  TempFolder folder;
  SampleColumns samples = RandomSamples(100, 5);
  samples.cell[7].y += 1 << 27;
  const auto refused =
      WriteSamples(folder / "a.drc", SampleFormat::kDraco, samples, HeaderFor(samples, kCell));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_TRUE(folder.List().empty());
}

TEST(DracoWriter, TurnsNoNormalByMoreThanHalfADegree) {
  SampleColumns samples = RandomSamples(50'000, 77);
  samples.normal[0] = {0, 0, 1}, samples.normal[1] = {0, -1, 0}, samples.normal[2] = {-1, 0, 0};
  const auto cloud = WriteAndDecode(samples, HeaderFor(samples, kNormal));
  ASSERT_NE(cloud, nullptr);
  const auto normals = DracoColumn<float, 3>(*cloud, "normal");
  double worst = 0;
  for (std::size_t i = 0; i < normals.size(); ++i) {
    const Vec3 n{normals[i][0], normals[i][1], normals[i][2]};
    const Vec3 m{samples.normal[i].x, samples.normal[i].y, samples.normal[i].z};
    EXPECT_NEAR(Norm(n), 1, 1e-6);
    worst = std::max(worst, std::atan2(Norm(Cross(n, m)), Dot(n, m)));
    EXPECT_LT(Norm(n - m), i < 3 ? 1e-6 : 0.01) << "the axes' own normals are kept";
  }
  EXPECT_LT(worst * 180 / M_PI, 0.5);
}

TEST(DracoWriter, KeepsBarycentricWeightsToAMillionth) {
  SampleColumns samples = RandomSamples(1000, 77);
  samples.barycentric[0] = {1, 0, 0};
  samples.barycentric[1] = {0, 1 + 1e-16, -1e-17};
  const auto cloud = WriteAndDecode(samples, HeaderFor(samples, kBarycentric));
  ASSERT_NE(cloud, nullptr);
  const auto weights = DracoColumn<float, 3>(*cloud, "barycentric");
  for (std::size_t i = 0; i < weights.size(); ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      ASSERT_NEAR(weights[i][k], samples.barycentric[i][k], 0x1p-21 + 1e-12) << "sample " << i;
    }
  }
  EXPECT_EQ(weights[0], (std::array<float, 3>{1, 0, 0}));
  EXPECT_EQ(weights[1], (std::array<float, 3>{0, 1, 0}));
}

TEST(DracoWriter, IsReadByDracosOwnProgram) {
  if (system("command -v draco_decoder >/dev/null") != 0) {
    GTEST_SKIP() << "no draco_decoder on this machine";
  }
  TempFolder folder;
  const SampleColumns samples = RandomSamples(1234, 5);
  ASSERT_TRUE(WriteSamples(folder / "a.drc", SampleFormat::kDraco, samples,
                           HeaderFor(samples, kAllAttributes)));
  const std::string command =
      "draco_decoder -i '" + (folder / "a.drc") + "' -o '" + (folder / "a.ply") + "' >/dev/null";
  ASSERT_EQ(system(command.c_str()), 0);
  EXPECT_NE(ReadFile(folder / "a.ply").find("element vertex 1234\n"), std::string::npos);
}

}  // namespace
}  // namespace strata::io
