#include "server/summary_json.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace strata::server {
namespace {

using nlohmann::json;
using testing::HasSubstr;
using testing::Not;

SampleCommand Command() {
  SampleCommand command;
  command.input = "in.ply";
  command.output = "out.drc";
  return command;
}

SampleStats Stats() {
  SampleStats stats;
  stats.read = {.vertices = 10, .faces = 20, .triangles = 30};
  stats.skipped = {1, 2, 3, 4};
  stats.sampled = 20;
  stats.bounds.Add({-1, -2, -3});
  stats.bounds.Add({1, 2, 3});
  stats.mesh_area = 12.5;
  stats.cell_area = 12.5;
  stats.lattice = {{0.5, 0.5, 0.5}, 0.25};
  stats.surface_hash = "0123";
  stats.cells = 1234;
  stats.pieces = 5678;
  stats.survivors = 1000;
  stats.lattice_seconds = 1;
  stats.scan_seconds = 2;
  stats.reject_seconds = 3;
  stats.passes = 2;
  return stats;
}

JobFigures Figures() {
  JobFigures figures;
  figures.mesh = {"ply", "ascii", "gzip"};
  figures.open_seconds = 0.5;
  figures.write_seconds = 0.25;
  figures.total_seconds = 7;
  figures.open_bytes = 100;
  figures.scan_bytes = 400;
  figures.write_bytes = 4321;
  figures.threads = 3;
  return figures;
}

TEST(SummaryJson, HoldsEverythingTheJobCounted) {
  const json found = json::parse(SummaryJson(Command(), Stats(), Figures()));
  EXPECT_EQ(found["mesh"]["vertices"], 10);
  EXPECT_EQ(found["mesh"]["triangles"], 30);
  EXPECT_EQ(
      found["mesh"]["skipped"],
      (json{
          {"index_out_of_range", 1}, {"too_few_corners", 2}, {"non_finite", 3}, {"zero_area", 4}}));
  EXPECT_EQ(found["mesh"]["area"], 12.5);
  EXPECT_EQ(found["mesh"]["bounds"]["min"], (json{-1, -2, -3}));
  EXPECT_EQ(found["lattice"]["origin"], (json{0.5, 0.5, 0.5}));
  EXPECT_EQ(found["lattice"]["edge"], 0.25);
  EXPECT_EQ(found["cells"], 1234);
  EXPECT_EQ(found["pieces"], 5678);
  EXPECT_EQ(found["samples"], (json{{"before_rejection", 1234}, {"after_rejection", 1000}}));
  EXPECT_EQ(found["surface_hash"], "0123");
  EXPECT_EQ(found["threads"], 3);
  EXPECT_EQ(found["options"]["lambda"], 5);
  EXPECT_EQ(found["seconds"], 7);
  EXPECT_GT(found["peak_memory_bytes"], 1'000'000);
}

TEST(SummaryJson, TellsSecondsAndBytesByStage) {
  const json stages = json::parse(SummaryJson(Command(), Stats(), Figures()))["stages"];
  EXPECT_EQ(stages["open"], (json{{"seconds", 0.5}, {"bytes", 100}}));
  EXPECT_EQ(stages["lattice"], (json{{"seconds", 1.0}, {"bytes", 400}}));
  EXPECT_EQ(stages["scan"], (json{{"seconds", 2.0}, {"bytes", 400}}));
  EXPECT_EQ(stages["reject"]["seconds"], 3);
  EXPECT_EQ(stages["write"], (json{{"seconds", 0.25}, {"bytes", 4321}}));
}

TEST(SummaryJson, SurvivesNamesThatAreNotUtf8) {
  SampleCommand command = Command();
  command.input = "caf\xe9.ply";
  EXPECT_TRUE(json::accept(SummaryJson(command, Stats(), Figures())));
}

TEST(SummaryText, NamesCountsAndReasons) {
  const std::string text = SummaryText(Command(), Stats(), Figures());
  EXPECT_THAT(text, HasSubstr("1,000 of 1,234 occupied cells of edge 0.25"));
  EXPECT_THAT(text, HasSubstr("skipped 10 (index_out_of_range 1, too_few_corners 2"));
  EXPECT_THAT(text, HasSubstr("7.00 s: opening 0.50 s, scan 3.00 s, rejection 3.00 s"));
  EXPECT_THAT(text, HasSubstr("out.drc, 4.32 kB"));
  EXPECT_THAT(text, Not(HasSubstr("picture")));
}

TEST(InfoText, HoldsWhatTheMeshHolds) {
  MeshSummary summary;
  summary.read = {.vertices = 1000, .faces = 2000, .triangles = 3000};
  summary.skipped[3] = 7;
  summary.area = 1.5;
  summary.bounds.Add({500000.125, 0, 0});
  const std::string text = InfoText({"obj", "ascii", "zstd"}, summary);
  EXPECT_THAT(text, HasSubstr("obj, ascii, zstd"));
  EXPECT_THAT(text, HasSubstr("1,000"));
  EXPECT_THAT(text, HasSubstr("7 (zero_area 7)"));
  EXPECT_THAT(text, HasSubstr("500000.125"));
}

TEST(InfoJson, SaysNullForTheBoundsOfNothing) {
  const json found = json::parse(InfoJson({"stl", "ascii", "none"}, {}));
  EXPECT_EQ(found["format"], "stl");
  EXPECT_TRUE(found["bounds"].is_null());
  EXPECT_EQ(found["area"], 0);
  EXPECT_EQ(found["skipped"]["zero_area"], 0);
}

}  // namespace
}  // namespace strata::server
