// What a killed scan leaves, and going on from it.
#include "core/checkpoint.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/reservoir_store.h"
#include "core/sample_mesh.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/counting_source.h"
#include "tests/support/samples_equal.h"
#include "tests/support/soup.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

/// What stood on disk when a checkpoint had been saved.
struct Saved {
  std::string checkpoint, runs;
};

/// A place that remembers every checkpoint, as if the process had died after each.
class RememberedPlace : public CheckpointPlace {
 public:
  explicit RememberedPlace(std::optional<Saved> former = {}) : former_(std::move(former)) {
    if (former_) WriteFile(path_, former_->runs);
  }
  Result<std::unique_ptr<ScratchFile>> OpenRuns(std::uint64_t keep) override {
    if (keep == 0) former_.reset();
    const int fd = open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    EXPECT_GE(fd, 0);
    EXPECT_LE(keep, std::filesystem::file_size(path_));
    EXPECT_EQ(ftruncate(fd, static_cast<off_t>(keep)), 0);
    return std::make_unique<ScratchFile>(fd, folder_.path(), keep);
  }
  Result<std::optional<std::string>> Load() override {
    if (!former_) return std::optional<std::string>();
    return std::optional<std::string>(former_->checkpoint);
  }
  Result<void> Save(std::string_view bytes) override {
    if (fails_after_ == saved_.size()) return Fail(ErrorCode::kIo, "no more checkpoints");
    saved_.push_back({std::string(bytes), ReadFile(path_)});
    return {};
  }
  void FailAfter(std::size_t checkpoints) { fails_after_ = checkpoints; }
  const std::vector<Saved>& saved() const { return saved_; }

 private:
  TempFolder folder_;
  std::string path_ = folder_ / "runs";
  std::optional<Saved> former_;
  std::vector<Saved> saved_;
  std::optional<std::size_t> fails_after_;
};

/// A sphere of about a cell per triangle, some of whose triangles do not count.
std::string MeshIn(const std::string& format) {
  Soup soup = SphereSoup(200'000, Order::kCoherent, false);
  for (std::size_t i = 7; i < soup.faces.size(); i += 997) soup.faces[i][1] = soup.faces[i][0];
  for (std::size_t i = 5; i < soup.faces.size(); i += 1999)
    soup.faces[i][2] = soup.vertices.size() + i;
  return SoupBytes(soup, format);
}

class Checkpoints : public testing::TestWithParam<const char*> {
 protected:
  Checkpoints() {
    auto opened = ScratchFolder::Open(folder_.path());
    EXPECT_TRUE(opened);
    scratch_ = std::move(*opened);
    options_.lattice = Resolution{350};
    options_.attributes = kNormal | kArea | kCell | kBarycentric;
    options_.threads = 2;
  }

  /// Samples `mesh` in little memory, with `place` for what outlives the process.
  Result<SampleResult> Sample(const std::string& mesh, RememberedPlace& place,
                              std::uint64_t* bytes_read = nullptr) const {
    std::uint64_t count = 0;
    RunContext context(2 * WorkerBytes(2048, 2));
    context.SetScratch(scratch_.get());
    context.SetCheckpoints(&place);
    auto reader = io::OpenMesh(std::make_unique<CountingSource>(io::MemorySource(mesh), &count));
    EXPECT_TRUE(reader);
    auto result = SampleMesh(**reader, options_, context);
    if (bytes_read != nullptr) *bytes_read = count;
    return result;
  }

  TempFolder folder_;
  std::unique_ptr<ScratchFolder> scratch_;
  SampleOptions options_;
};

TEST_P(Checkpoints, AllLeadToTheSameSamplesAndFigures) {
  const std::string mesh = MeshIn(GetParam());
  RememberedPlace whole;
  const auto expected = Sample(mesh, whole);
  ASSERT_TRUE(expected) << expected.error().message;
  EXPECT_EQ(expected->stats.resumed_at, 0u);
  ASSERT_GE(whole.saved().size(), 2u) << "the mesh is too small to show anything";
  std::uint64_t before = 0;
  for (std::size_t i = 0; i < whole.saved().size(); ++i) {
    SCOPED_TRACE(i);
    RememberedPlace place(whole.saved()[i]);
    const auto resumed = Sample(mesh, place);
    ASSERT_TRUE(resumed) << resumed.error().message;
    EXPECT_TRUE(SameSamples(resumed->samples, expected->samples));
    EXPECT_EQ(resumed->samples.barycentric, expected->samples.barycentric);
    const SampleStats &a = resumed->stats, &b = expected->stats;
    EXPECT_TRUE(SameStats(a, b));
    EXPECT_EQ(a.mesh_area, b.mesh_area);
    EXPECT_EQ(a.skipped, b.skipped);
    EXPECT_EQ(a.sampled, b.sampled);
    EXPECT_EQ(a.read.vertices, b.read.vertices);
    EXPECT_EQ(a.read.faces, b.read.faces);
    EXPECT_EQ(a.read.triangles, b.read.triangles);
    EXPECT_GE(a.resumed_at, before);
    EXPECT_GT(a.resumed_at, 0u);
    before = a.resumed_at;
  }
  EXPECT_EQ(before, expected->stats.read.triangles) << "the last checkpoint is of the whole scan";
}

TEST_P(Checkpoints, LeadOnToFurtherOnes) {
  const std::string mesh = MeshIn(GetParam());
  RememberedPlace whole;
  const auto expected = Sample(mesh, whole);
  ASSERT_TRUE(expected);
  std::optional<Saved> former;
  int deaths = 0;
  for (; deaths < 100; ++deaths) {
    RememberedPlace place(former);
    // A job that goes on from a whole scan saves that, and then the merge of its runs.
    place.FailAfter(former ? 2 : 1);
    const auto result = Sample(mesh, place);
    if (result) {
      EXPECT_TRUE(SameSamples(result->samples, expected->samples));
      break;
    }
    EXPECT_EQ(result.error().message, "no more checkpoints");
    ASSERT_FALSE(place.saved().empty());
    former = place.saved().back();
  }
  EXPECT_GE(deaths, 1);
  EXPECT_LT(deaths, 100);
}

INSTANTIATE_TEST_SUITE_P(Formats, Checkpoints,
                         testing::Values("binary_little_endian", "ascii", "obj"),
                         [](const auto& test) { return std::string(test.param); });

using BinaryCheckpoints = Checkpoints;

TEST_F(BinaryCheckpoints, ReadOnlyWhatIsLeftOfABinaryFile) {
  const std::string mesh = MeshIn("binary_little_endian");
  options_.lattice = VoxelSize{0.006};
  RememberedPlace whole;
  std::uint64_t all = 0, left = 0;
  ASSERT_TRUE(Sample(mesh, whole, &all));
  const std::size_t middle = whole.saved().size() / 2;
  RememberedPlace place(whole.saved()[middle]);
  const auto resumed = Sample(mesh, place, &left);
  ASSERT_TRUE(resumed);
  const double passed = static_cast<double>(resumed->stats.resumed_at) /
                        static_cast<double>(resumed->stats.read.triangles);
  EXPECT_GT(passed, 0.1);
  constexpr double kFaceBytes = 13;
  const double saved = passed * kFaceBytes * static_cast<double>(resumed->stats.read.triangles);
  EXPECT_LT(static_cast<double>(left), static_cast<double>(all) - 0.9 * saved);
}

TEST_F(BinaryCheckpoints, OfAWrongLatticeAreGivenUpWithIt) {
  // A vertex that no triangle uses gives a lattice that only the end of the scan shows to be wrong.
  Soup soup = SphereSoup(200'000, Order::kCoherent, false);
  soup.vertices.push_back({3, 3, 3});
  const std::string mesh = SoupBytes(soup, "binary_little_endian");
  RememberedPlace whole;
  const auto expected = Sample(mesh, whole);
  ASSERT_TRUE(expected) << expected.error().message;
  for (const Saved& saved : whole.saved()) {
    RememberedPlace place(saved);
    const auto resumed = Sample(mesh, place);
    ASSERT_TRUE(resumed) << resumed.error().message;
    EXPECT_TRUE(SameSamples(resumed->samples, expected->samples));
    EXPECT_TRUE(SameStats(resumed->stats, expected->stats));
  }
}

TEST_F(BinaryCheckpoints, NameTheRunsThatAMergeLeavesBeforeTheOldOnesGo) {
  const std::string mesh = MeshIn("binary_little_endian");
  RememberedPlace whole;
  ASSERT_TRUE(Sample(mesh, whole));
  int merged = 0;
  for (const Saved& saved : whole.saved()) {
    const auto former = UnpackCheckpoint(saved.checkpoint);
    ASSERT_TRUE(former);
    RememberedPlace place(saved);
    ASSERT_TRUE(Sample(mesh, place));
    ASSERT_FALSE(place.saved().empty());
    const auto last = UnpackCheckpoint(place.saved().back().checkpoint);
    ASSERT_TRUE(last);
    EXPECT_TRUE(last->scan.complete);
    EXPECT_EQ(last->runs.size(), 1u) << "the samples were taken from a merge that is not named";
    merged += former->scan.complete && former->runs.size() > 1;
  }
  EXPECT_GE(merged, 1) << "no checkpoint was of a whole scan with runs to merge";
}

// --- Damage --------------------------------------------------------------------------------------

Checkpoint SomeCheckpoint() {
  Checkpoint checkpoint;
  checkpoint.lattice = {{1, 2, 3}, 0.25};
  checkpoint.bounds.emplace();
  checkpoint.bounds->Add({4, 5, 6});
  checkpoint.probes = {7, 8};
  checkpoint.scan.next = 9;
  checkpoint.scan.totals.pieces = 10;
  checkpoint.runs = {{11, 12, 13, 14}, {15, 16, 17, 18}};
  return checkpoint;
}

TEST(PackedCheckpoint, UnpacksToWhatItWas) {
  const Checkpoint in = SomeCheckpoint();
  const auto bytes = PackCheckpoint(in);
  ASSERT_TRUE(bytes);
  const auto out = UnpackCheckpoint(*bytes);
  ASSERT_TRUE(out) << out.error().message;
  EXPECT_EQ(out->lattice.origin, in.lattice.origin);
  EXPECT_EQ(out->lattice.edge, in.lattice.edge);
  EXPECT_EQ(out->bounds, in.bounds);
  EXPECT_EQ(out->probes, in.probes);
  EXPECT_EQ(out->scan.next, in.scan.next);
  EXPECT_EQ(out->scan.complete, in.scan.complete);
  EXPECT_EQ(out->scan.totals.pieces, in.scan.totals.pieces);
  ASSERT_EQ(out->runs.size(), 2u);
  EXPECT_EQ(out->runs[1].offset, 15u);
  EXPECT_EQ(out->runs[1].cells, 18u);
}

TEST(PackedCheckpoint, IsRefusedWhenCutOrFlippedAnywhere) {
  const auto bytes = PackCheckpoint(SomeCheckpoint());
  ASSERT_TRUE(bytes);
  for (std::size_t n = 0; n < bytes->size(); ++n) {
    const auto cut = UnpackCheckpoint(bytes->substr(0, n));
    ASSERT_FALSE(cut) << n;
    EXPECT_EQ(cut.error().code, ErrorCode::kIo);
    std::string flipped = *bytes;
    flipped[n] = static_cast<char>(flipped[n] ^ 0x10);
    // A bit that means nothing may be either way.
    const auto unpacked = UnpackCheckpoint(flipped);
    if (unpacked) {
      EXPECT_EQ(*PackCheckpoint(*unpacked), *bytes) << n;
    }
  }
}

TEST_F(BinaryCheckpoints, WithADamagedRunAreAnError) {
  const std::string mesh = MeshIn("binary_little_endian");
  RememberedPlace whole;
  ASSERT_TRUE(Sample(mesh, whole));
  Saved damaged = whole.saved()[1];
  const auto checkpoint = UnpackCheckpoint(damaged.checkpoint);
  ASSERT_TRUE(checkpoint);
  char& byte = damaged.runs[checkpoint->runs[0].offset + checkpoint->runs[0].bytes / 2];
  byte = static_cast<char>(byte ^ 1);
  RememberedPlace place(damaged);
  const auto result = Sample(mesh, place);
  ASSERT_FALSE(result);
  EXPECT_EQ(result.error().code, ErrorCode::kIo);
  EXPECT_NE(result.error().message.find("is damaged at byte"), std::string::npos)
      << result.error().message;
}

}  // namespace
}  // namespace strata::test
