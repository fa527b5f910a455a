#include "server/provenance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "core/version.h"

namespace strata::server {
namespace {

using nlohmann::json;

SampleStats Stats() {
  SampleStats stats;
  stats.surface_hash = "00112233445566778899aabbccddeeff";
  stats.lattice = {{0.1, -1.0 / 3, 1e-300}, 2.0 / 3};
  return stats;
}

json Parsed(const SampleOptions& options) {
  return json::parse(Provenance(options, 0.01, Stats()));
}

TEST(Provenance, NamesEverythingThatDecidesTheSamples) {
  SampleOptions options;
  options.lattice = Height{7};
  options.lambda = 2.5;
  options.min_distance = 0.75;
  options.seed = ~std::uint64_t{0};
  options.integrator = Integrator::kSubdivide;
  options.attributes = kNormal | kArea;
  const json found = Parsed(options);
  EXPECT_EQ(found["program"], "strata");
  EXPECT_EQ(found["version"], kVersion);
  EXPECT_EQ(found["surface_hash"], "00112233445566778899aabbccddeeff");
  EXPECT_EQ(found["lambda"], 2.5);
  EXPECT_EQ(found["min_distance"], 0.75);
  EXPECT_EQ(found["seed"], ~std::uint64_t{0});
  EXPECT_EQ(found["integrator"], "subdivide");
  EXPECT_EQ(found["attributes"], (json{"normal", "area"}));
  EXPECT_EQ(found["position_error"], 0.01);
  EXPECT_EQ(found["lattice"]["height"], 7);
}

TEST(Provenance, NamesTheMethodAndOfUniformSamplesTheirNumber) {
  EXPECT_EQ(Parsed({})["method"], "stratified");
  SampleOptions options;
  options.method = Method::kUniform;
  SampleStats stats = Stats();
  stats.survivors = 1234;
  const json found = json::parse(Provenance(options, 0.01, stats));
  EXPECT_EQ(found["method"], "uniform");
  EXPECT_EQ(found["count"], 1234);
  EXPECT_FALSE(found.contains("lambda")) << "has no say";
}

TEST(Provenance, GivesTheLatticeBackBitForBit) {
  const json lattice = Parsed({})["lattice"];
  EXPECT_EQ(lattice["resolution"], 128);
  EXPECT_EQ(lattice["edge"].get<double>(), 2.0 / 3);
  EXPECT_EQ(lattice["origin"][0].get<double>(), 0.1);
  EXPECT_EQ(lattice["origin"][1].get<double>(), -1.0 / 3);
  EXPECT_EQ(lattice["origin"][2].get<double>(), 1e-300);
}

TEST(Provenance, ExcludesTheRunAndTheFile) {
  SampleOptions options;
  SampleStats stats = Stats();
  const std::string first = Provenance(options, 0.01, stats);
  options.threads = 7;
  options.batch_size = 1;
  options.strict = true;
  stats.read.vertices = 12;
  stats.read.triangles = 99;
  stats.skipped[0] = 5;
  stats.scan_seconds = 3;
  stats.passes = 2;
  EXPECT_EQ(Provenance(options, 0.01, stats), first);
}

TEST(Provenance, IsOneLineWithKeysInAFixedOrder) {
  const std::string line = Provenance({}, 0.01, Stats());
  EXPECT_EQ(line.find('\n'), std::string::npos);
  EXPECT_THAT(line, testing::StartsWith("{\"program\":\"strata\",\"version\":"));
  EXPECT_LT(line.find("\"surface_hash\""), line.find("\"lambda\""));
  EXPECT_LT(line.find("\"lambda\""), line.find("\"lattice\""));
}

}  // namespace
}  // namespace strata::server
