// What goes wrong while reservoirs are on disk: a clear error, and nothing left behind.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>

#include "core/reservoir_store.h"
#include "core/sample_mesh.h"
#include "core/scan.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/failing_source.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/mesh_text.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

constexpr int kSide = 300;

// A sheet of hills: about a cell per triangle.
std::vector<NineFloats> Hills() {
  std::vector<NineFloats> facets;
  const auto add = [&](std::initializer_list<std::pair<int, int>> corners) {
    NineFloats facet;
    for (const auto& [i, j] : corners) {
      for (const double v : {0.9 * i, 0.9 * j, 3 * std::sin(i * 0.3) * std::cos(j * 0.2)}) {
        facet.push_back(static_cast<float>(v));
      }
    }
    facets.push_back(facet);
  };
  for (int i = 0; i < kSide; ++i) {
    for (int j = 0; j < kSide; ++j) {
      add({{i, j}, {i + 1, j}, {i, j + 1}});
      add({{i + 1, j}, {i + 1, j + 1}, {i, j + 1}});
    }
  }
  return facets;
}

Triangles AsTriangles(const std::vector<NineFloats>& facets) {
  Triangles mesh;
  for (const NineFloats& f : facets) {
    mesh.push_back({Vec3{f[0], f[1], f[2]}, Vec3{f[3], f[4], f[5]}, Vec3{f[6], f[7], f[8]}});
  }
  return mesh;
}

// A job whose reservoirs do not fit its budget, and its scratch directory.
class SpillFaults : public testing::Test {
 protected:
  SpillFaults() : context_(2 * WorkerBytes(2048, 2)) {
    auto opened = ScratchFolder::Open(folder_.path());
    EXPECT_TRUE(opened);
    scratch_ = std::move(*opened);
    context_.SetScratch(scratch_.get());
    options_.lattice = VoxelSize{1};
    options_.threads = 2;
  }

  // Everything, the samples' way out included.
  Result<std::uint64_t> Sample(MeshReader& reader) {
    auto sampled = SampleMeshStreamed(reader, options_, context_);
    if (!sampled) return Forward(sampled);
    SampleColumns columns;
    for (std::uint64_t n = 0;; n += columns.size()) {
      const auto more = sampled->samples->Next(columns);
      if (!more) return Forward(more);
      if (!*more) return n;
    }
  }

  // What this process holds open in the scratch directory, under a name that can be opened again.
  std::optional<std::string> OpenScratchFile() const {
    for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
      std::error_code failed;
      const auto target = std::filesystem::read_symlink(entry.path(), failed).string();
      if (!failed && target.starts_with(folder_.path() + "/")) return entry.path().string();
    }
    return std::nullopt;
  }

  TempFolder folder_;
  std::unique_ptr<ScratchFolder> scratch_;
  RunContext context_;
  SampleOptions options_;
};

TEST_F(SpillFaults, WithoutAFaultTheJobSpillsAndLeavesNothing) {
  MemoryMesh mesh(AsTriangles(Hills()));
  std::uint64_t most_on_disk = 0;
  mesh.set_on_read([&](std::uint64_t) {
    const auto file = OpenScratchFile();
    if (file)
      most_on_disk = std::max<std::uint64_t>(most_on_disk, std::filesystem::file_size(*file));
  });
  const auto samples = Sample(mesh);
  ASSERT_TRUE(samples) << samples.error().message;
  EXPECT_GT(most_on_disk, 0u);
  EXPECT_FALSE(OpenScratchFile());
  EXPECT_TRUE(folder_.List().empty());
}

TEST_F(SpillFaults, AReadErrorAnywhereInTheInputIsReportedAsItself) {
  const std::string bytes = MakeBinaryStl(Hills());
  for (std::uint64_t fail_at = bytes.size() / 8; fail_at < bytes.size();
       fail_at += bytes.size() / 8) {
    auto reader = io::OpenMesh(
        std::make_unique<FailingSource>(io::MemorySource(bytes, "hills.stl"), fail_at));
    ASSERT_TRUE(reader) << reader.error().message;
    const auto samples = Sample(**reader);
    ASSERT_FALSE(samples) << fail_at;
    EXPECT_EQ(samples.error().code, ErrorCode::kIo);
    EXPECT_EQ(samples.error().message, "hills.stl: byte " + std::to_string(fail_at) + ": injected");
    EXPECT_FALSE(OpenScratchFile());
    EXPECT_EQ(context_.memory().taken(), 0u);
  }
}

// The file size limit of this process, for as long as it lives.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(std::uint64_t bytes) {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit small = {bytes, before_.rlim_max};
    EXPECT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  }
  ~FileSizeLimit() { setrlimit(RLIMIT_FSIZE, &before_); }

 private:
  rlimit before_{};
};

// The limit is met while the scan spills, while runs are merged, or never; by whichever thread.
TEST_F(SpillFaults, AScratchFileThatTakesNoMoreBytesIsAnIoErrorThatNamesItsDirectory) {
  MemoryMesh mesh(AsTriangles(Hills()));
  const auto expected = Sample(mesh);
  ASSERT_TRUE(expected);
  int refused = 0;
  for (std::uint64_t limit = 1 << 12; limit <= std::uint64_t{1} << 26; limit *= 2) {
    SCOPED_TRACE(limit);
    ASSERT_TRUE(mesh.Rewind());
    const auto samples = [&] {
      const FileSizeLimit small(limit);
      return Sample(mesh);
    }();
    EXPECT_FALSE(OpenScratchFile());
    EXPECT_EQ(context_.memory().taken(), 0u);
    if (samples) {
      EXPECT_EQ(*samples, *expected);
      continue;
    }
    ++refused;
    EXPECT_EQ(samples.error().code, ErrorCode::kIo);
    EXPECT_EQ(samples.error().message, "scratch space " + folder_.path() + ": File too large");
  }
  EXPECT_GE(refused, 5);
  EXPECT_LT(refused, 15);
}

TEST_F(SpillFaults, ARunThatIsDamagedBetweenScanAndMergeIsAnIoErrorThatSaysWhere) {
  MemoryMesh mesh(AsTriangles(Hills()));
  TestRandom random(41);
  for (int round = 0; round < 8; ++round) {
    ASSERT_TRUE(mesh.Rewind());
    std::uint64_t damaged = 0;
    // At each read, until there is a run: its bytes are never written again.
    mesh.set_on_read([&](std::uint64_t) {
      const auto path = OpenScratchFile();
      if (damaged > 0 || !path) return;
      const int file = open(path->c_str(), O_RDWR | O_CLOEXEC);
      ASSERT_GE(file, 0);
      // The first frame is longer than a page.
      damaged = 64 + random.Below(4096 - 64);
      unsigned char byte = 0;
      if (pread(file, &byte, 1, static_cast<off_t>(damaged)) == 1) {
        byte ^= 0x5a;
        EXPECT_EQ(pwrite(file, &byte, 1, static_cast<off_t>(damaged)), 1);
      } else {
        damaged = 0;  // The file is new.
      }
      close(file);
    });
    const auto samples = Sample(mesh);
    ASSERT_GT(damaged, 0u);
    ASSERT_FALSE(samples) << "seed 41, byte " << damaged;
    EXPECT_EQ(samples.error().code, ErrorCode::kIo);
    EXPECT_TRUE(samples.error().message.starts_with("scratch space " + folder_.path() +
                                                    ": the run from byte 0 is damaged at byte 0: "))
        << samples.error().message;
    EXPECT_EQ(context_.memory().taken(), 0u);
  }
}

TEST_F(SpillFaults, AScratchDirectoryThatVanishesIsNamed) {
  std::filesystem::remove(folder_.path());
  MemoryMesh mesh(AsTriangles(Hills()));
  const auto samples = Sample(mesh);
  ASSERT_FALSE(samples);
  EXPECT_EQ(samples.error().code, ErrorCode::kIo);
  EXPECT_EQ(samples.error().message,
            "scratch directory " + folder_.path() + ": No such file or directory");
}

TEST_F(SpillFaults, CancellingEndsTheMergeOfRuns) {
  StoreLimits limits;
  limits.max_bytes = 0;  // Every cache becomes a run.
  limits.scratch = scratch_.get();
  limits.context = &context_;
  ReservoirStore store(limits);
  MemoryMesh mesh(AsTriangles(Hills()));
  ScanOptions scan;
  scan.kernel = {LatticeFor(VoxelSize{1}), 5, 0, {}};
  scan.threads = 1;
  ASSERT_TRUE(ScanTriangles(mesh, scan, store, context_));
  ASSERT_GT(store.run_count(), 1u);
  context_.Cancel();
  const auto blocks = store.Blocks(context_.memory());
  ASSERT_FALSE(blocks);
  EXPECT_EQ(blocks.error().code, ErrorCode::kCancelled);
}

}  // namespace
}  // namespace strata::test
