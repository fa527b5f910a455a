// `-o x.vdb` from end to end, read back by OpenVDB's own library and held against ply and npz of
// the same run.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "tests/support/process.h"
#include "tests/support/read_vdb.h"

namespace strata::test {
namespace {

using nlohmann::json;
using testing::ElementsAre;
using testing::HasSubstr;

// A torus of quadrilaterals with colours, a label of faces and a quality.
std::string PaintedTorus() {
  constexpr int kAround = 40, kAcross = 16;
  std::ostringstream text;
  text << "ply\nformat ascii 1.0\nelement vertex " << kAround * kAcross
       << "\nproperty double x\nproperty double y\nproperty double z\nproperty uchar red\n"
          "property uchar green\nproperty uchar blue\nproperty float quality\nelement face "
       << kAround * kAcross
       << "\nproperty list uchar int vertex_indices\nproperty int label\nend_header\n";
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kAcross; ++j) {
      const double u = 2 * M_PI * i / kAround, v = 2 * M_PI * j / kAcross;
      const double r = 2 + 0.7 * std::cos(v);
      text << r * std::cos(u) + 50 << " " << r * std::sin(u) - 20 << " " << 0.7 * std::sin(v) << " "
           << 6 * i << " " << 15 * j << " " << 200 - 5 * i << " " << 0.01 * i * j << "\n";
    }
  }
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kAcross; ++j) {
      const int k = (i + 1) % kAround, l = (j + 1) % kAcross;
      text << "4 " << i * kAcross + j << " " << k * kAcross + j << " " << k * kAcross + l << " "
           << i * kAcross + l << " " << 1'000'000 + i << "\n";
    }
  }
  return text.str();
}

// Rows of a binary PLY whose properties are doubles, floats, ints and uchars.
struct PlyRows {
  std::map<std::string, std::vector<double>> columns;
  std::size_t rows = 0;
};

PlyRows ReadPly(const std::string& path) {
  const std::string bytes = ReadText(path), end = "end_header\n";
  std::size_t at = bytes.find(end) + end.size();
  std::istringstream header(bytes.substr(0, at));
  PlyRows ply;
  std::vector<std::pair<std::string, std::string>> properties;
  for (std::string line; std::getline(header, line);) {
    std::istringstream words(line);
    std::string first, second, third;
    words >> first >> second >> third;
    if (first == "element") ply.rows = std::stoull(third);
    if (first == "property") properties.emplace_back(second, third);
  }
  const auto take = [&](auto zero) {
    std::memcpy(&zero, bytes.data() + at, sizeof zero);
    at += sizeof zero;
    return static_cast<double>(zero);
  };
  for (std::size_t i = 0; i < ply.rows; ++i) {
    for (const auto& [type, name] : properties) {
      ply.columns[name].push_back(type == "double"  ? take(double())
                                  : type == "float" ? take(float())
                                  : type == "int"   ? take(std::int32_t())
                                                    : take(std::uint8_t()));
    }
  }
  EXPECT_EQ(at, bytes.size());
  return ply;
}

Outcome Strata(const std::vector<std::string>& arguments) { return Run(STRATA_BINARY, arguments); }

class Vdb : public testing::Test {
 protected:
  Vdb() { WriteFile(folder_ / "torus.ply", PaintedTorus()); }

  Outcome Sample(const std::string& output, std::vector<std::string> options) const {
    options.insert(options.begin(), {"sample", folder_ / "torus.ply", "-o", folder_ / output});
    return Strata(options);
  }
  std::string Bytes(const std::string& output, const std::vector<std::string>& options) const {
    const Outcome outcome = Sample(output, options);
    EXPECT_EQ(outcome.status, 0) << outcome.err;
    return ReadText(folder_ / output);
  }

  ScratchFolder folder_;
};

TEST_F(Vdb, HasThePointsAndAttributesOfThePlyOfTheSameRun) {
  const std::vector<std::string> options = {"--voxel-size", "0.11", "--attributes", "all"};
  Bytes("a.ply", options);
  Bytes("a.vdb", options);
  const PlyRows ply = ReadPly(folder_ / "a.ply");
  const VdbPoints vdb = ReadVdb(folder_ / "a.vdb");
  ASSERT_EQ(vdb.size(), ply.rows);
  EXPECT_EQ(vdb.active_voxels, ply.rows);
  EXPECT_EQ(vdb.edge, 0.11);
  EXPECT_THAT(vdb.names, ElementsAre("P", "N", "triangle", "barycentric", "cell", "area", "weight",
                                     "Cd", "quality", "label"));
  EXPECT_EQ(json::parse(vdb.metadata.at("strata"))["lattice"]["edge"], 0.11);

  const auto at = [&](const char* name, std::size_t i) { return ply.columns.at(name)[i]; };
  std::map<Cell, std::size_t> rows;
  for (std::size_t i = 0; i < ply.rows; ++i) {
    rows[{static_cast<std::int32_t>(at("cell_x", i)), static_cast<std::int32_t>(at("cell_y", i)),
          static_cast<std::int32_t>(at("cell_z", i))}] = i;
  }
  for (std::size_t p = 0; p < vdb.size(); ++p) {
    ASSERT_TRUE(rows.contains(vdb.voxel[p])) << "point " << p << " is not in its sample's cell";
    const std::size_t i = rows[vdb.voxel[p]];
    const Vec3 position{at("x", i), at("y", i), at("z", i)};
    ASSERT_LE(Norm(vdb.position[p] - position), 0.01 * 0.11);
    ASSERT_EQ(vdb.At<float>("N", p, 0), at("nx", i));
    ASSERT_EQ(vdb.At<float>("N", p, 2), at("nz", i));
    ASSERT_EQ(vdb.At<std::int64_t>("triangle", p), at("triangle", i));
    ASSERT_EQ(vdb.At<double>("barycentric", p, 1), at("b1", i));
    ASSERT_EQ(vdb.At<std::int32_t>("cell", p, 2), at("cell_z", i));
    ASSERT_EQ(vdb.At<double>("area", p), at("area", i));
    ASSERT_EQ(vdb.At<double>("weight", p), at("weight", i));
    ASSERT_EQ(std::lround(255 * vdb.At<float>("Cd", p, 0)), at("red", i));
    ASSERT_EQ(std::lround(255 * vdb.At<float>("Cd", p, 2)), at("blue", i));
    ASSERT_EQ(vdb.At<float>("quality", p), at("quality", i));
    ASSERT_EQ(vdb.At<std::int32_t>("label", p), at("label", i));
  }
}

TEST_F(Vdb, HasTheSameBytesWhateverTheThreadsAndTheMemory) {
  const std::string bytes = Bytes("a.vdb", {"--resolution", "90", "--attributes", "all"});
  for (const std::vector<std::string>& options : {std::vector<std::string>{"--threads", "1"},
                                                  {"--threads", "3", "--batch-size", "7"},
                                                  {"--memory", "100M"}}) {
    std::vector<std::string> all = {"--resolution", "90", "--attributes", "all"};
    all.insert(all.end(), options.begin(), options.end());
    EXPECT_TRUE(Bytes("b.vdb", all) == bytes) << options[1];
  }
}

TEST_F(Vdb, OfMergedSharesIsThatOfOneProcess) {
  for (const std::string share : {"0/2", "1/2"}) {
    const Outcome scanned = Strata({"scan", folder_ / "torus.ply", "--share", share, "--resolution",
                                    "60", "-o", folder_ / share.substr(0, 1)});
    ASSERT_EQ(scanned.status, 0) << scanned.err;
  }
  const Outcome merged = Strata({"merge", folder_ / "1", folder_ / "0", "-o", folder_ / "m.vdb"});
  ASSERT_EQ(merged.status, 0) << merged.err;
  EXPECT_TRUE(Bytes("a.vdb", {"--resolution", "60"}) == ReadText(folder_ / "m.vdb"));
}

TEST_F(Vdb, HoldsUniformSamplesAndThoseOfSubdivideWhereTheyLie) {
  for (const std::vector<std::string>& options :
       {std::vector<std::string>{"--method", "uniform", "--count", "5000"},
        {"--integrator", "subdivide", "--resolution", "30"}}) {
    std::vector<std::string> all = {"--attributes", "none"};
    all.insert(all.end(), options.begin(), options.end());
    Bytes("a.ply", all);
    Bytes("a.vdb", all);
    const PlyRows ply = ReadPly(folder_ / "a.ply");
    const VdbPoints vdb = ReadVdb(folder_ / "a.vdb");
    ASSERT_EQ(vdb.size(), ply.rows);
    Vec3 middle, expected;
    for (std::size_t i = 0; i < ply.rows; ++i) {
      middle = middle + vdb.position[i];
      expected =
          expected + Vec3{ply.columns.at("x")[i], ply.columns.at("y")[i], ply.columns.at("z")[i]};
      for (int a = 0; a < 3; ++a) {
        ASSERT_GE(vdb.in_voxel[i][a], -0.5);
        ASSERT_LT(vdb.in_voxel[i][a], 0.5);
      }
    }
    EXPECT_LE(Norm(middle - expected) / static_cast<double>(ply.rows), 0.01 * vdb.edge);
  }
}

TEST_F(Vdb, GoesToStandardOutput) {
  const std::string bytes = Bytes("a.vdb", {"--resolution", "20"});
  const Outcome piped = Strata({"sample", folder_ / "torus.ply", "-o", "-", "--format", "vdb",
                                "--resolution", "20", "--quiet"});
  EXPECT_EQ(piped.status, 0) << piped.err;
  EXPECT_TRUE(piped.out == bytes);
}

}  // namespace
}  // namespace strata::test
