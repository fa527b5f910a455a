// Folders of tiles, read back by the readers of tests/support.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>

#include "io/atomic_file.h"
#include "io/sample_writer.h"
#include "tests/support/read_tiles.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::HeaderFor;
using test::kProvenance;
using test::MessageOf;
using test::RandomSamples;
using test::ReadFile;
using test::ReadTile;
using test::ReadTiles;
using test::ReadTileset;
using test::TempFolder;
using test::WriteFile;
using Names = std::vector<std::string>;

constexpr double kEdge = 0.125;

// Samples on a wavy surface, one a cell, in canonical order: blocks of 8^3 cells, then cells.
SampleColumns Surface(int across, Vec3 corner = {}, double edge = kEdge) {
  struct Place {
    std::array<int, 6> order;
    Cell cell;
  };
  std::vector<Place> places;
  for (int x = -across / 2; x < across - across / 2; ++x) {
    for (int y = 0; y < across; ++y) {
      const int z = static_cast<int>(std::lround(9 * std::sin(x * 0.2) + 5 * std::cos(y * 0.3)));
      places.push_back({{x >> 3, y >> 3, z >> 3, x, y, z}, {x, y, z}});
    }
  }
  std::sort(places.begin(), places.end(),
            [](const Place& a, const Place& b) { return a.order < b.order; });
  SampleColumns s = RandomSamples(places.size(), 99, edge);
  for (std::size_t i = 0; i < places.size(); ++i) {
    const Cell c = places[i].cell;
    const double in = static_cast<double>(i % 97) / 97;
    s.cell[i] = c;
    s.position[i] = corner + Vec3{c.x + in, c.y + 1 - in - 1e-3, c.z + in / 2} * edge;
  }
  return s;
}

SampleHeader TiledHeader(const SampleColumns& samples, AttributeSet attributes = kAllAttributes,
                         Vec3 lattice_origin = {}, double edge = kEdge) {
  SampleHeader header = HeaderFor(samples, attributes, edge);
  header.lattice_origin = lattice_origin;
  return header;
}

Result<std::uint64_t> WriteTiled(const std::string& path, const SampleColumns& samples,
                                 const SampleHeader& header, const WriterResources& resources,
                                 std::size_t portion = SIZE_MAX) {
  auto writer = OpenSampleWriter(path, SampleFormat::kDraco, header, resources);
  if (!writer) return Forward(writer);
  for (std::size_t i = 0; i < samples.size();) {
    const std::size_t n = std::min(portion, samples.size() - i);
    auto written = (*writer)->Write(test::Slice(samples, i, n));
    if (!written) return Forward(written);
    i += n;
  }
  return (*writer)->Finish();
}

ReadTileset WriteAndRead(const SampleColumns& samples, const SampleHeader& header,
                         std::uint64_t tile_samples) {
  TempFolder folder;
  const auto written =
      WriteTiled(folder / "a.drc", samples, header, {.tile_samples = tile_samples});
  EXPECT_TRUE(written) << MessageOf(written);
  return written ? ReadTiles(folder / "a.drc", header.attributes) : ReadTileset();
}

// Every file in a folder, by its path within.
std::map<std::string, std::string> Contents(const std::string& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder)) {
    if (!entry.is_regular_file()) continue;
    files[entry.path().lexically_relative(folder).string()] = ReadFile(entry.path().string());
  }
  return files;
}

// The tiles' samples by id: `triangle` must be unique.
std::map<std::uint64_t, std::pair<const ReadTile*, std::size_t>> ByTriangle(
    const ReadTileset& set) {
  std::map<std::uint64_t, std::pair<const ReadTile*, std::size_t>> found;
  for (const ReadTile& tile : set.tiles) {
    for (std::size_t i = 0; i < tile.samples.size(); ++i) {
      const bool fresh = found.emplace(tile.samples.triangle[i], std::pair(&tile, i)).second;
      EXPECT_TRUE(fresh) << "sample " << tile.samples.triangle[i] << " stands twice";
    }
  }
  return found;
}

// The world position as the page says it can be had from integers alone.
Vec3 AtStep(const ReadTileset& set, const std::array<std::int64_t, 3>& k) {
  return {set.step * static_cast<double>(k[0]), set.step * static_cast<double>(k[1]),
          set.step * static_cast<double>(k[2])};
}

// Every decoded position is a whole number of steps from zero, exactly, and not before its tile's.
void ExpectOnOneLattice(const ReadTileset& set) {
  for (const ReadTile& tile : set.tiles) {
    for (const Vec3& p : tile.samples.position) {
      std::array<std::int64_t, 3> k;
      for (int a = 0; a < 3; ++a) {
        k[static_cast<std::size_t>(a)] = std::llround(p[a] / set.step);
        ASSERT_GE(k[static_cast<std::size_t>(a)], tile.first_step[static_cast<std::size_t>(a)]);
      }
      ASSERT_EQ(AtStep(set, k), p) << tile.path;
    }
  }
}

TEST(TileWriter, HoldsTheSamplesOfThePlyWithEveryAttribute) {
  SampleColumns samples = Surface(40);
  std::iota(samples.triangle.begin(), samples.triangle.end(), std::uint64_t{1} << 40);
  const SampleHeader header = TiledHeader(samples);
  const ReadTileset set = WriteAndRead(samples, header, 100);
  ASSERT_GT(set.tiles.size(), 16u);
  const auto found = ByTriangle(set);
  ASSERT_EQ(found.size(), samples.size());
  for (std::size_t i = 0; i < samples.size(); ++i) {
    ASSERT_TRUE(found.contains(samples.triangle[i])) << "sample " << i;
    const auto [tile, k] = found.at(samples.triangle[i]);
    const SampleColumns& s = tile->samples;
    ASSERT_LE(Norm(s.position[k] - samples.position[i]), header.position_error);
    ASSERT_EQ(s.cell[k], samples.cell[i]);
    ASSERT_EQ(s.area[k], static_cast<double>(static_cast<float>(samples.area[i])));
    const Vec3 n{s.normal[k].x, s.normal[k].y, s.normal[k].z};
    const Vec3 m{samples.normal[i].x, samples.normal[i].y, samples.normal[i].z};
    ASSERT_LT(Norm(n - m), 0.01);
    for (std::size_t c = 0; c < 3; ++c) {
      ASSERT_NEAR(s.barycentric[k][c], samples.barycentric[i][c], 5e-7);
    }
  }
}

TEST(TileWriter, ManifestTellsCountsSizesHashesAndBounds) {
  TempFolder folder;
  const SampleColumns samples = Surface(30);
  const SampleHeader header = TiledHeader(samples, kNormal | kTriangle, {0.5, -3, 1});
  const auto size = WriteTiled(folder / "a.drc", samples, header, {.tile_samples = 70});
  ASSERT_TRUE(size) << MessageOf(size);
  const ReadTileset set = ReadTiles(folder / "a.drc", header.attributes);
  EXPECT_EQ(set.json["provenance"], kProvenance);
  EXPECT_EQ(set.json["count"], samples.size());
  EXPECT_EQ(set.json["tile_samples"], 70);
  EXPECT_EQ(set.json["attributes"], (Names{"position", "normal", "triangle"}));
  EXPECT_EQ(test::Vec3From(set.json["lattice"]["origin"]), (Vec3{0.5, -3, 1}));
  EXPECT_EQ(set.json["lattice"]["edge"], kEdge);
  EXPECT_EQ(set.json["position_error"], header.position_error);
  std::uint64_t count = 0, bytes = ReadFile(folder / "a.drc/tileset.json").size();
  for (const ReadTile& tile : set.tiles) {
    EXPECT_EQ(tile.count, tile.samples.size()) << tile.path;
    EXPECT_LE(tile.count, 70u) << tile.path;
    EXPECT_EQ(tile.bytes, tile.file.size()) << tile.path;
    Bounds box;
    for (const Vec3& p : tile.samples.position) box.Add(p);
    EXPECT_EQ(tile.bounds, box) << tile.path;
    count += tile.count, bytes += tile.bytes;
  }
  EXPECT_EQ(count, samples.size());
  EXPECT_EQ(bytes, *size) << "what Finish returns";
  EXPECT_EQ(Contents(folder / "a.drc").size(), set.tiles.size() + 1) << "no file but those named";
}

TEST(TileWriter, HashesAreThoseOfSha256sum) {
  if (system("command -v sha256sum >/dev/null") != 0) GTEST_SKIP() << "no sha256sum here";
  TempFolder folder;
  const SampleColumns samples = Surface(12);
  ASSERT_TRUE(WriteTiled(folder / "a.drc", samples, TiledHeader(samples), {.tile_samples = 40}));
  std::string list;
  for (const ReadTile& tile : ReadTiles(folder / "a.drc", 0).tiles) {
    list += tile.sha256 + "  " + tile.path + "\n";
  }
  WriteFile(folder / "list", list);
  const std::string check =
      "cd '" + (folder / "a.drc") + "' && sha256sum --check --strict --quiet ../list";
  EXPECT_EQ(system(check.c_str()), 0);
}

TEST(TileWriter, PutsAllTilesOnOneLatticeWithoutSeams) {
  for (const Vec3 corner : {Vec3{}, Vec3{431'234.5, 5'412'345.25, -312.125}}) {
    const SampleColumns samples = Surface(40, corner);
    const ReadTileset set = WriteAndRead(samples, TiledHeader(samples, 0, corner), 60);
    ASSERT_GT(set.tiles.size(), 10u);
    ExpectOnOneLattice(set);
  }
}

TEST(TileWriter, KeepsThePositionErrorAtEveryScale) {
  for (const double edge : {1e-9, 0.3, 7e8}) {
    for (const double error : {1e-5, 0.01, 1.0}) {
      const Vec3 corner = Vec3{1000, -300, 20} * edge;
      const SampleColumns samples = Surface(24, corner, edge);
      SampleHeader header = TiledHeader(samples, kTriangle, corner, edge);
      header.position_error = error * edge;
      const ReadTileset set = WriteAndRead(samples, header, 50);
      ExpectOnOneLattice(set);
      const auto found = ByTriangle(set);
      for (std::size_t i = 0; i < samples.size(); ++i) {
        const auto [tile, k] = found.at(samples.triangle[i]);
        ASSERT_LE(Norm(tile->samples.position[k] - samples.position[i]), header.position_error)
            << "edge " << edge << " error " << error;
      }
    }
  }
}

TEST(TileWriter, TilesAreDisjointCubesOfCellsAndKeepTheOrder) {
  SampleColumns samples = Surface(48);
  std::iota(samples.triangle.begin(), samples.triangle.end(), 0);
  const ReadTileset set = WriteAndRead(samples, TiledHeader(samples, kTriangle | kCell), 90);
  std::map<std::array<int, 4>, int> owner;
  for (std::size_t t = 0; t < set.tiles.size(); ++t) {
    const SampleColumns& s = set.tiles[t].samples;
    EXPECT_TRUE(std::is_sorted(s.triangle.begin(), s.triangle.end())) << set.tiles[t].path;
    // The smallest aligned cube of cells around the tile holds no other tile's samples.
    int level = 0;
    const auto node = [&](Cell c) {
      return std::array{level, c.x >> level, c.y >> level, c.z >> level};
    };
    while (!std::all_of(s.cell.begin(), s.cell.end(),
                        [&](Cell c) { return node(c) == node(s.cell[0]); })) {
      ++level;
    }
    for (std::size_t other = 0; other < set.tiles.size(); ++other) {
      if (other == t) continue;
      for (const Cell& c : set.tiles[other].samples.cell) ASSERT_NE(node(c), node(s.cell[0]));
    }
  }
}

TEST(TileWriter, GivesTheSameBytesWhateverThePortionsScratchAndBudget) {
  TempFolder folder;
  const SampleColumns samples = Surface(40);
  const SampleHeader header = TiledHeader(samples);
  ASSERT_TRUE(WriteTiled(folder / "a.drc", samples, header, {.tile_samples = 64}));
  const auto expected = Contents(folder / "a.drc");
  auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch) << MessageOf(scratch);
  for (const std::size_t portion : {std::size_t{1}, std::size_t{333}, SIZE_MAX}) {
    for (const std::uint64_t budget : {std::uint64_t{12} << 20, MemoryAccount::kUnlimited}) {
      for (ScratchFolder* const space : {static_cast<ScratchFolder*>(nullptr), scratch->get()}) {
        MemoryAccount memory(budget);
        const WriterResources resources{.memory = &memory, .scratch = space, .tile_samples = 64};
        const auto written = WriteTiled(folder / "b.drc", samples, header, resources, portion);
        ASSERT_TRUE(written) << MessageOf(written);
        EXPECT_TRUE(Contents(folder / "b.drc") == expected) << portion << " " << budget;
        EXPECT_EQ(memory.taken(), 0u) << "shares are given back";
      }
    }
  }
}

TEST(TileWriter, TakesTilesOfOneSample) {
  const SampleColumns samples = Surface(9);
  const ReadTileset set = WriteAndRead(samples, TiledHeader(samples, kCell | kTriangle), 1);
  EXPECT_EQ(set.tiles.size(), samples.size());
  EXPECT_EQ(ByTriangle(set).size(), samples.size());
}

TEST(TileWriter, DoesNotSplitACellThatHoldsMoreThanATile) {
  SampleColumns samples = Surface(9);
  for (Vec3& p : samples.position) p = {0.01, 0.01, 0.01};
  for (Cell& c : samples.cell) c = {0, 0, 0};
  const ReadTileset set = WriteAndRead(samples, TiledHeader(samples, 0), 10);
  ASSERT_EQ(set.tiles.size(), 1u);
  EXPECT_EQ(set.tiles[0].count, samples.size());
}

TEST(TileWriter, TakesThePositionsCellWhereNoCellIsGiven) {
  TempFolder folder;
  SampleColumns samples = Surface(30);
  const SampleHeader header = TiledHeader(samples, kNormal);
  ASSERT_TRUE(WriteTiled(folder / "a.drc", samples, header, {.tile_samples = 70}));
  samples.cell.clear();
  ASSERT_TRUE(WriteTiled(folder / "b.drc", samples, header, {.tile_samples = 70}));
  EXPECT_TRUE(Contents(folder / "a.drc") == Contents(folder / "b.drc"));
}

// Each parcel alone gives the very tiles that it has among all.
TEST(TileWriter, WritesTheTilesOfAParcelWithoutTheOthers) {
  TempFolder folder;
  const SampleColumns samples = Surface(40);
  SampleHeader header = TiledHeader(samples);
  header.surface = {{-100, -100, -100}, {100, 100, 100}};
  for (const Cell cell : {Cell{-32, 0, -32}, Cell{-32, 0, 0}, Cell{-32, 32, -32}, Cell{-32, 32, 0},
                          Cell{0, 0, -32}, Cell{0, 0, 0}, Cell{0, 32, -32}, Cell{0, 32, 0}}) {
    header.parcels.push_back({CodeOf(cell), 5, 0});
  }
  std::sort(header.parcels.begin(), header.parcels.end(),
            [](const OctreeNode& a, const OctreeNode& b) { return a.first < b.first; });
  ASSERT_TRUE(WriteTiled(folder / "all.drc", samples, header, {.tile_samples = 100}));
  const auto all = Contents(folder / "all.drc");
  std::size_t tiles = 0;
  for (const OctreeNode& parcel : header.parcels) {
    SampleColumns mine;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      if (parcel.Holds(CodeOf(samples.cell[i]))) mine.Append(test::Slice(samples, i, 1));
    }
    SampleHeader alone = header;
    alone.count = mine.size();
    alone.parcels = {parcel};
    if (mine.size() <= 100) continue;  // It would be a file.
    ASSERT_TRUE(WriteTiled(folder / "one.drc", mine, alone, {.tile_samples = 100}));
    for (const auto& [path, bytes] : Contents(folder / "one.drc")) {
      if (path == "tileset.json") continue;
      EXPECT_TRUE(all.at(path) == bytes) << path;
      ++tiles;
    }
  }
  EXPECT_GT(tiles, 10u);
}

TEST(TileWriter, StaysOneFileUpToTheTileSize) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  const SampleHeader header = TiledHeader(samples);
  ASSERT_TRUE(WriteTiled(folder / "a.drc", samples, header, {.tile_samples = samples.size()}));
  ASSERT_TRUE(test::WriteSamples(folder / "b.drc", SampleFormat::kDraco, samples, header));
  EXPECT_TRUE(ReadFile(folder / "a.drc") == ReadFile(folder / "b.drc"));
  EXPECT_EQ(folder.List(), (Names{"a.drc", "b.drc"}));
}

TEST(TileWriter, SplitsWhatIsTooWideForOneGridOfFloats) {
  // Two clusters, 2^26 cells apart: one grid would have 2^32 steps.
  SampleColumns samples = Surface(20);
  for (std::size_t i = samples.size() / 2; i < samples.size(); ++i) {
    samples.position[i].x += 0x1p26 * kEdge;
    samples.cell[i].x += 1 << 26;
  }
  const SampleHeader header = TiledHeader(samples, kCell);
  const auto one = WriteAndRead(samples, header, samples.size() - 1);
  std::uint64_t count = 0;
  for (const ReadTile& tile : one.tiles) count += tile.count;
  EXPECT_EQ(count, samples.size());
  ExpectOnOneLattice(one);
}

// --- Refusals ------------------------------------------------------------------------------------

TEST(TileWriter, RefusesStandardOutputAndPipesBeforeTheWork) {
  TempFolder folder;
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  const SampleColumns samples = Surface(10);
  for (const std::string& path : {std::string("-"), std::string("/dev/null"), folder / "pipe"}) {
    const auto refused =
        OpenSampleWriter(path, SampleFormat::kDraco, TiledHeader(samples), {.tile_samples = 10});
    ASSERT_FALSE(refused) << path;
    EXPECT_EQ(refused.error().code, ErrorCode::kInvalidArgument);
    EXPECT_NE(refused.error().message.find("100 samples, but one drc holds 10"), std::string::npos)
        << MessageOf(refused);
  }
}

TEST(TileWriter, SaysTheBytesThatTheBudgetLacksBeforeTheWork) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  MemoryAccount memory(1 << 20);
  for (const std::uint64_t tile_samples : {50u, 1000u}) {
    const auto refused =
        OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, TiledHeader(samples),
                         {.memory = &memory, .tile_samples = tile_samples});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
    EXPECT_NE(refused.error().message.find("the memory budget is 1048576 bytes"), std::string::npos)
        << MessageOf(refused);
  }
  EXPECT_EQ(folder.List(), Names{});
}

TEST(TileWriter, FailsBeforeEncodingWhenOthersHoldTheMemory) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch);
  MemoryAccount memory(std::uint64_t{100} << 20);
  const auto others = memory.Take(std::uint64_t{99} << 20, "others");
  const auto refused =
      WriteTiled(folder / "a.drc", samples, TiledHeader(samples),
                 {.memory = &memory, .scratch = scratch->get(), .tile_samples = 50});
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(refused.error().message.find("Draco's encoder"), std::string::npos)
      << MessageOf(refused);
  EXPECT_FALSE(std::filesystem::exists(folder / "a.drc"));
}

TEST(TileWriter, RefusesAnErrorFinerThanDoublesOrFloatsHold) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  SampleHeader header = TiledHeader(samples);
  for (const double error : {0.0, 1e-18}) {
    header.position_error = error;
    const auto refused =
        OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, header, {.tile_samples = 10});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget) << MessageOf(refused);
  }
  EXPECT_EQ(folder.List(), Names{});
}

TEST(TileWriter, RefusesALatticeThatIsNone) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  for (const double bad : {0.0, -1.0, HUGE_VAL, std::nan("")}) {
    SampleHeader header = TiledHeader(samples);
    header.edge = bad;
    EXPECT_FALSE(
        OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, header, {.tile_samples = 10}));
  }
}

TEST(TileWriter, ReplacesFilesAndTileFoldersAndNoOtherFolder) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  const SampleHeader header = TiledHeader(samples);
  WriteFile(folder / "a.drc", "a file");
  std::map<std::string, std::string> first;
  for (const std::uint64_t tile_samples : {20, 10, 20}) {
    const auto written =
        WriteTiled(folder / "a.drc", samples, header, {.tile_samples = tile_samples});
    ASSERT_TRUE(written) << MessageOf(written);
    if (first.empty()) first = Contents(folder / "a.drc");
    EXPECT_EQ(Contents(folder / "a.drc") == first, tile_samples == 20);
    EXPECT_EQ(folder.List(), Names{"a.drc"});
  }
  ASSERT_TRUE(WriteTiled(folder / "a.drc", samples, header, {}));
  EXPECT_TRUE(ReadFile(folder / "a.drc").starts_with("DRACO")) << "a file again";
  std::filesystem::create_directory(folder / "mine");
  WriteFile(folder / "mine/letter", "dear");
  for (const std::uint64_t tile_samples : {20u, 1000u}) {
    EXPECT_FALSE(WriteTiled(folder / "mine", samples, header, {.tile_samples = tile_samples}));
  }
  EXPECT_EQ(ReadFile(folder / "mine/letter"), "dear");
  EXPECT_EQ(folder.List(), (Names{"a.drc", "mine"}));
}

// --- Faults --------------------------------------------------------------------------------------

TEST(TileWriter, LeavesNothingWithoutFinishAndKeepsWhatWasThere) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  WriteFile(folder / "a.drc", "old");
  {
    auto writer = OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, TiledHeader(samples),
                                   {.tile_samples = 10});
    ASSERT_TRUE(writer) << MessageOf(writer);
    ASSERT_TRUE((*writer)->Write(samples));
    EXPECT_EQ(folder.List().size(), 2u);
  }
  EXPECT_EQ(folder.List(), Names{"a.drc"});
  EXPECT_EQ(ReadFile(folder / "a.drc"), "old");
}

TEST(TileWriter, StopsInFinishWhenTheJobIsCancelled) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  RunContext context;
  auto writer = OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, TiledHeader(samples),
                                 {.context = &context, .tile_samples = 10});
  ASSERT_TRUE(writer);
  ASSERT_TRUE((*writer)->Write(samples));
  context.Cancel();
  const auto finished = (*writer)->Finish();
  ASSERT_FALSE(finished);
  EXPECT_EQ(finished.error().code, ErrorCode::kCancelled);
  writer->reset();
  EXPECT_EQ(folder.List(), Names{});
}

TEST(TileWriter, AFullDiskKeepsWhatWasThere) {
  TempFolder folder;
  std::filesystem::create_directory(folder / "disk");
  if (mount("tmpfs", (folder / "disk").c_str(), "tmpfs", 0, "size=64k") != 0) {
    GTEST_SKIP() << "mounting a small disk is not permitted here";
  }
  WriteFile(folder / "disk/a.drc", "old");
  const SampleColumns samples = Surface(100);
  const auto written =
      WriteTiled(folder / "disk/a.drc", samples, TiledHeader(samples), {.tile_samples = 300});
  Names names;
  for (const auto& e : std::filesystem::directory_iterator(folder / "disk")) {
    names.push_back(e.path().filename().string());
  }
  const std::string kept = ReadFile(folder / "disk/a.drc");
  umount((folder / "disk").c_str());
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_NE(written.error().message.find("tiles/"), std::string::npos) << MessageOf(written);
  EXPECT_NE(written.error().message.find("No space left"), std::string::npos);
  EXPECT_EQ(names, Names{"a.drc"});
  EXPECT_EQ(kept, "old");
}

TEST(TileWriter, AFullScratchDiskLeavesNothing) {
  TempFolder folder;
  std::filesystem::create_directory(folder / "disk");
  if (mount("tmpfs", (folder / "disk").c_str(), "tmpfs", 0, "size=512k") != 0) {
    GTEST_SKIP() << "mounting a small disk is not permitted here";
  }
  const SampleColumns samples = Surface(160);
  {
    auto scratch = ScratchFolder::Open(folder / "disk");
    ASSERT_TRUE(scratch) << MessageOf(scratch);
    for (const SampleFormat format : {SampleFormat::kDraco, SampleFormat::kNpz}) {
      auto writer = OpenSampleWriter(folder / "a.drc", format, TiledHeader(samples),
                                     {.scratch = scratch->get(), .tile_samples = 300});
      ASSERT_TRUE(writer) << MessageOf(writer);
      auto written = (*writer)->Write(samples);
      if (written) {
        auto finished = (*writer)->Finish();
        if (!finished) written = Forward(finished);
      }
      ASSERT_FALSE(written);
      EXPECT_EQ(written.error().code, ErrorCode::kIo);
      EXPECT_NE(written.error().message.find("scratch"), std::string::npos) << MessageOf(written);
    }
  }
  umount((folder / "disk").c_str());
  EXPECT_EQ(folder.List(), Names{"disk"});
}

TEST(TileWriter, TheNextWriterRemovesWhatAKilledProcessLeft) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const pid_t child = fork();
  if (child == 0) {
    auto writer = OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, TiledHeader(samples),
                                   {.tile_samples = 10});
    if (!writer || !(*writer)->Write(samples)) _exit(1);
    if (write(ends[1], "x", 1) != 1) _exit(1);
    for (;;) pause();
  }
  char byte = 0;
  ASSERT_EQ(read(ends[0], &byte, 1), 1);
  close(ends[0]), close(ends[1]);
  ASSERT_TRUE(
      test::WriteSamples(folder / "b.ply", SampleFormat::kPly, samples, TiledHeader(samples)));
  EXPECT_EQ(folder.List().size(), 2u) << "the process lives, so its folder must stay";
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  const std::string left = folder.List().front();
  EXPECT_TRUE(left.ends_with(".folder")) << left;
  std::filesystem::create_directory(folder / left + "/tiles");
  WriteFile(folder / left + "/tiles/000000.drc", "half");
  ASSERT_TRUE(
      test::WriteSamples(folder / "c.ply", SampleFormat::kPly, samples, TiledHeader(samples)));
  EXPECT_EQ(folder.List(), (Names{"b.ply", "c.ply"}));
}

TEST(TileWriter, AProgramThatIsAboutToExitRemovesTheFolder) {
  TempFolder folder;
  const SampleColumns samples = Surface(10);
  auto writer = OpenSampleWriter(folder / "a.drc", SampleFormat::kDraco, TiledHeader(samples),
                                 {.tile_samples = 10});
  ASSERT_TRUE(writer);
  ASSERT_TRUE((*writer)->Write(samples));
  RemoveUnfinishedOutputs();
  EXPECT_EQ(folder.List(), Names{});
  EXPECT_FALSE((*writer)->Finish());
  EXPECT_EQ(folder.List(), Names{});
}

}  // namespace
}  // namespace strata::io
