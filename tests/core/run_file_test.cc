#include "core/run_file.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <map>
#include <utility>
#include <vector>

#include "core/block_merge.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/scratch_test.h"

namespace strata::test {
namespace {

using Blocks = std::vector<BlockReservoirs>;

Reservoir RandomReservoir(TestRandom& random, bool barycentric) {
  Reservoir r;
  r.time = random.Unit() * 10;
  r.hash = random.Bits();
  r.triangle = random.Bits();
  r.local = random.InBox({-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5});
  if (barycentric) r.barycentric[0] = random.Unit(), r.barycentric[1] = random.Unit();
  r.normal = {static_cast<float>(random.Unit()), -1, 0};
  r.area = random.Bits() >> 20;
  return r;
}

// Distinct blocks in ascending order, some full.
Blocks RandomBlocks(TestRandom& random, std::size_t n, bool barycentric) {
  std::map<Cell, BlockReservoirs> all;
  while (all.size() < n) {
    const auto at = [&] { return static_cast<std::int32_t>(random.Below(9)) - 4; };
    const Cell block{at() * 100000, at(), at()};
    BlockReservoirs& b = all[block];
    b.block = block;
    b.cells.clear();
    const std::uint64_t density = random.Below(8) == 0 ? 1 : 2 + random.Below(40);
    for (std::uint16_t offset = 0; offset < 512; ++offset) {
      if (random.Below(density) == 0)
        b.cells.push_back({offset, RandomReservoir(random, barycentric)});
    }
    if (b.cells.empty()) b.cells.push_back({7, RandomReservoir(random, barycentric)});
  }
  Blocks blocks;
  for (auto& [place, block] : all) blocks.push_back(std::move(block));
  return blocks;
}

bool Same(const Reservoir& a, const Reservoir& b) {
  return a.time == b.time && a.hash == b.hash && a.triangle == b.triangle && a.local == b.local &&
         a.barycentric[0] == b.barycentric[0] && a.barycentric[1] == b.barycentric[1] &&
         a.normal == b.normal && a.area == b.area;
}
bool Same(const Blocks& a, const Blocks& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const auto& x, const auto& y) {
    return x.block == y.block && std::equal(x.cells.begin(), x.cells.end(), y.cells.begin(),
                                            y.cells.end(), [](const auto& c, const auto& d) {
                                              return c.offset == d.offset &&
                                                     Same(c.reservoir, d.reservoir);
                                            });
  });
}

Result<RunExtent> Write(ScratchFile& file, const Blocks& blocks, bool barycentric) {
  RunWriter writer([&](std::string_view bytes) { return file.Append(bytes); }, file.size(),
                   barycentric);
  for (const BlockReservoirs& block : blocks) {
    if (auto added = writer.Add(block); !added) return Forward(added);
  }
  return writer.Finish();
}

Result<Blocks> Read(BlockStream& stream) {
  Blocks blocks;
  for (;;) {
    BlockReservoirs block;
    const auto more = stream.Next(block);
    if (!more) return Forward(more);
    if (!*more) return blocks;
    blocks.push_back(std::move(block));
  }
}

class RunFile : public ScratchTest {
 protected:
  std::string Bytes(const ScratchFile& file) {
    std::string bytes(file.size(), 0);
    EXPECT_TRUE(file.ReadAt(0, bytes));
    return bytes;
  }
};

TEST_F(RunFile, GivesBackEveryBlock) {
  TestRandom random(31);
  for (const bool barycentric : {false, true}) {
    for (const std::size_t n : {0, 1, 2, 300}) {
      const Blocks blocks = RandomBlocks(random, n, barycentric);
      const auto extent = Write(*file_, blocks, barycentric);
      ASSERT_TRUE(extent) << extent.error().message;
      EXPECT_EQ(extent->blocks, n);
      RunReader reader(*file_, *extent);
      const auto read = Read(reader);
      ASSERT_TRUE(read) << read.error().message;
      EXPECT_TRUE(Same(*read, blocks)) << n;
    }
  }
}

TEST_F(RunFile, RefusesEveryProperPrefix) {
  TestRandom random(32);
  const auto extent = Write(*file_, RandomBlocks(random, 40, false), false);
  ASSERT_TRUE(extent);
  const std::string bytes = Bytes(*file_);
  for (std::size_t n = 0; n < bytes.size(); n += n < 200 ? 1 : 37) {
    const auto cut = NewFile();
    ASSERT_TRUE(cut->Append(std::string_view(bytes).substr(0, n)));
    RunReader reader(*cut, {0, n, 0, 0});
    const auto read = Read(reader);
    ASSERT_FALSE(read) << n;
    EXPECT_EQ(read.error().code, ErrorCode::kCorruptInput) << read.error().message;
    EXPECT_NE(read.error().message.find("damaged at byte"), std::string::npos);
  }
}

TEST_F(RunFile, RefusesEveryFlippedBit) {
  TestRandom random(33);
  const Blocks blocks = RandomBlocks(random, 30, true);
  const auto extent = Write(*file_, blocks, true);
  ASSERT_TRUE(extent);
  const std::string bytes = Bytes(*file_);
  std::size_t refused = 0, harmless = 0;
  for (std::size_t n = 0; n < bytes.size(); n += 1 + random.Below(60)) {
    std::string damaged = bytes;
    damaged[n] = static_cast<char>(damaged[n] ^ (1 << random.Below(8)));
    const auto file = NewFile();
    ASSERT_TRUE(file->Append(damaged));
    RunReader reader(*file, *extent);
    const auto read = Read(reader);
    // A bit that zstd does not use may be harmless; what comes back is never wrong.
    read ? ++harmless : ++refused;
    if (read) {
      EXPECT_TRUE(Same(*read, blocks)) << "byte " << n;
    }
  }
  std::printf("seed 33: %zu flips refused, %zu harmless\n", refused, harmless);
  EXPECT_GT(refused, 100 * harmless);
}

TEST_F(RunFile, RefusesCellsThatNoBlockHas) {
  const auto blocks = [](std::vector<std::uint16_t> offsets) {
    Blocks one = {{{1, 2, 3}, {}}};
    for (const std::uint16_t offset : offsets) one[0].cells.push_back({offset, {}});
    one.push_back({{1, 2, 4}, {{0, {}}}});
    return one;
  };
  const std::vector<std::uint16_t> good = {0, 1, 511};
  for (const auto& offsets : {good, {0, 512}, {7, 7}, {8, 7}, {}}) {
    const auto extent = Write(*file_, blocks(offsets), false);
    ASSERT_TRUE(extent);
    RunReader reader(*file_, *extent);
    const auto read = Read(reader);
    EXPECT_EQ(read.has_value(), offsets == good);
    if (!read) {
      EXPECT_NE(read.error().message.find("is damaged at byte"), std::string::npos);
    }
  }
}

TEST_F(RunFile, MergesRunsAsOneGridWould) {
  TestRandom random(34);
  std::vector<std::unique_ptr<BlockStream>> streams;
  std::map<Cell, std::map<std::uint16_t, Reservoir>> expected;
  for (int run = 0; run < 7; ++run) {
    const Blocks blocks = RandomBlocks(random, run == 3 ? 0 : 200, false);
    for (const BlockReservoirs& block : blocks) {
      for (const auto& [offset, reservoir] : block.cells) {
        expected[block.block][offset].Merge(reservoir);
      }
    }
    const auto extent = Write(*file_, blocks, false);
    ASSERT_TRUE(extent);
    streams.push_back(std::make_unique<RunReader>(*file_, *extent));
  }
  std::reverse(streams.begin(), streams.begin() + 3);
  BlockMerge merge(std::move(streams));
  const auto merged = Read(merge);
  ASSERT_TRUE(merged);
  Blocks all;
  for (const auto& [place, cells] : expected) {
    all.push_back({place, {}});
    for (const auto& [offset, reservoir] : cells) all.back().cells.push_back({offset, reservoir});
  }
  EXPECT_TRUE(Same(*merged, all));
}

}  // namespace
}  // namespace strata::test
