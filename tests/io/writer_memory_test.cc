// What the writers take of memory, measured: the highest resident set of a process of its own.
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>

#include "io/draco_cloud.h"
#include "io/sample_writer.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::MessageOf;
using test::TempFolder;

// STRATA_MEMORY_SAMPLES measures at another size than the quick one.
std::uint64_t Samples() {
  const char* const text = getenv("STRATA_MEMORY_SAMPLES");
  return text != nullptr ? std::strtoull(text, nullptr, 10) : 400'000;
}

std::int64_t PeakBytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return std::int64_t{1024} * usage.ru_maxrss;
}

// Columns of a flat sheet of cells, `n` of them from the `first` on, in rows of 2048 blocks.
SampleColumns Sheet(std::uint64_t first, std::size_t n) {
  SampleColumns s = test::RandomSamples(n, first + 1, 1, {}, 1);
  for (std::size_t i = 0; i < n; ++i) {
    const std::uint64_t index = first + i, block = index / 64, in = index % 64;
    const auto x = static_cast<std::int32_t>(block / 256 * 8 + in / 8);
    const auto y = static_cast<std::int32_t>(block % 256 * 8 + in % 8);
    s.cell[i] = {x, y, 0};
    s.position[i] = s.position[i] + Vec3{static_cast<double>(x), static_cast<double>(y), 0};
  }
  return s;
}

Result<std::uint64_t> WriteSheet(const std::string& path, SampleFormat format, std::uint64_t count,
                                 AttributeSet attributes, const WriterResources& resources) {
  SampleHeader header;
  header.count = count;
  header.attributes = attributes;
  header.position_error = 0.01;
  header.provenance = test::kProvenance;
  const auto rows = static_cast<double>(count / 64 / 256 * 8 + 8);
  header.bounds = {{0, 0, 0}, {rows, 2048, 1}};
  auto writer = OpenSampleWriter(path, format, header, resources);
  if (!writer) return Forward(writer);
  constexpr std::uint64_t kPortion = 4096;
  for (std::uint64_t done = 0; done < count; done += kPortion) {
    const SampleColumns part = Sheet(done, std::min(kPortion, count - done));
    if (auto written = (*writer)->Write(part); !written) return Forward(written);
  }
  return (*writer)->Finish();
}

// By how much the peak of a fresh process grows while it writes; -1 if it cannot.
std::int64_t GrowthOf(SampleFormat format, std::uint64_t count, AttributeSet attributes,
                      std::uint64_t tile_samples) {
  TempFolder folder;
  int ends[2];
  if (pipe(ends) != 0) return -1;
  const pid_t child = fork();
  if (child == 0) {
    // Whatever is loaded and initialised once does not count.
    static_cast<void>(WriteSheet(folder / "warm", format, 1000, attributes, {}));
    const std::int64_t before = PeakBytes();
    auto scratch = ScratchFolder::Open(folder.path());
    if (!scratch) _exit(1);
    const auto written = WriteSheet(folder / "out", format, count, attributes,
                                    {.scratch = scratch->get(), .tile_samples = tile_samples});
    if (!written) fprintf(stderr, "%s\n", MessageOf(written).c_str());
    const std::int64_t growth = written ? PeakBytes() - before : -1;
    if (write(ends[1], &growth, sizeof growth) != sizeof growth) _exit(1);
    scratch->reset();
    _exit(0);
  }
  close(ends[1]);
  std::int64_t growth = -1;
  EXPECT_EQ(read(ends[0], &growth, sizeof growth), static_cast<ssize_t>(sizeof growth));
  close(ends[0]);
  waitpid(child, nullptr, 0);
  return growth;
}

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define STRATA_SANITIZED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define STRATA_SANITIZED 1
#endif
#endif

class WriterMemory : public ::testing::Test {
 protected:
  void SetUp() override {
#ifdef STRATA_SANITIZED
    GTEST_SKIP() << "sanitizers change what memory is taken";
#endif
  }
  void Report(const char* what, std::int64_t bytes, std::uint64_t samples) {
    const auto each = static_cast<double>(bytes) / static_cast<double>(samples);
    std::printf("%s: %lld bytes, %.1f a sample\n", what, static_cast<long long>(bytes), each);
  }
};

TEST_F(WriterMemory, TheDracoEncoderStaysWithinItsShare) {
  const std::uint64_t count = Samples();
  for (const AttributeSet attributes : {0u, 1u, 2u, 4u, 8u, 16u, kAllAttributes}) {
    const auto growth = GrowthOf(SampleFormat::kDraco, count, attributes, count);
    ASSERT_GT(growth, 0);
    Report(("attributes " + std::to_string(attributes)).c_str(), growth, count);
    EXPECT_LE(growth, static_cast<std::int64_t>(DracoEncoderBytes(attributes, count, 18)));
  }
}

TEST_F(WriterMemory, TilesTakeNoMoreThanOneOfThem) {
  const std::uint64_t count = Samples(), tile = count / 8;
  const auto growth = GrowthOf(SampleFormat::kDraco, count, kNormal, tile);
  ASSERT_GT(growth, 0);
  Report("eight tiles and more", growth, tile);
  constexpr std::int64_t kBuffers = std::int64_t{12} << 20;
  EXPECT_LE(growth, static_cast<std::int64_t>(DracoEncoderBytes(kNormal, tile, 18)) + kBuffers);
}

TEST_F(WriterMemory, PlyXyzAndNpzTakeAFewMegabytes) {
  for (const SampleFormat format : {SampleFormat::kPly, SampleFormat::kXyz, SampleFormat::kNpz}) {
    const auto growth = GrowthOf(format, Samples(), kAllAttributes, 1);
    ASSERT_GE(growth, 0);
    EXPECT_LE(growth, std::int64_t{5} << 20);
  }
}

}  // namespace
}  // namespace strata::io
