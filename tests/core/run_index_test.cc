// The index of a run tells of every block, and damage is found.
#include "core/run_index.h"

#include <gtest/gtest.h>

#include "core/run_frame.h"
#include "tests/support/block_samples.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/scratch_test.h"

namespace strata::test {
namespace {

class RunIndexes : public ScratchTest {
 protected:
  RunExtent Write(ScratchFile& file, const std::vector<BlockReservoirs>& blocks) {
    VectorStream stream(blocks);
    RunWriter writer([&](std::string_view bytes) { return file.Append(bytes); }, file.size(),
                     false);
    const auto extent = writer.WriteAll(stream, nullptr);
    EXPECT_TRUE(extent) << extent.error().message;
    return *extent;
  }
  static Result<std::unique_ptr<RunIndex>> Open(const ScratchFile& file, const RunExtent& extent) {
    return RunIndex::Open(file, extent, NewUnpackContext());
  }
  static Result<std::vector<IndexedBlock>> All(RunIndex& index) {
    std::vector<IndexedBlock> blocks;
    for (IndexedBlock block;;) {
      const auto more = index.Next(block);
      if (!more) return Forward(more);
      if (!*more) return blocks;
      blocks.push_back(block);
    }
  }
};

// A sheet, and some thousand blocks of one cell.
Samples SheetAndDust(std::uint64_t seed) {
  TestRandom random(seed);
  auto cells = Sheet(150, 2, random);
  for (int i = 0; i < 3000; ++i) cells[{-1000 + 9 * i, i % 40 * 8, 3}].time = random.Unit();
  return Samples(cells);
}

TEST_F(RunIndexes, TellBlocksCellsAndFramesAndAreReadAgain) {
  const Samples samples = SheetAndDust(61);
  ASSERT_TRUE(file_->Append("something before the run"));
  const RunExtent extent = Write(*file_, samples.blocks);
  ASSERT_TRUE(file_->Append("and after it"));
  const auto index = Open(*file_, extent);
  ASSERT_TRUE(index) << index.error().message;
  for (int round = 0; round < 2; ++round) {
    const auto read = All(**index);
    ASSERT_TRUE(read) << read.error().message;
    ASSERT_EQ(read->size(), samples.blocks.size());
    for (std::size_t b = 0; b < read->size(); ++b) {
      const BlockReservoirs& block = samples.blocks[b];
      ASSERT_EQ((*read)[b].block, block.block);
      ASSERT_EQ(CellsIn((*read)[b].cells), block.cells.size());
      for (const auto& entry : block.cells) {
        ASSERT_TRUE((*read)[b].cells[entry.offset / 64] >> (entry.offset % 64) & 1);
      }
    }
    (*index)->Rewind();
  }
  EXPECT_EQ((*index)->extent().cells, samples.count);
}

TEST_F(RunIndexes, FramesTheyNameHoldTheirBlocksAndAreReadAlone) {
  const Samples samples = SheetAndDust(62);
  const RunExtent extent = Write(*file_, samples.blocks);
  const auto index = Open(*file_, extent);
  ASSERT_TRUE(index);
  const auto all = All(**index);
  ASSERT_TRUE(all);
  TestRandom random(63);
  for (int round = 0; round < 20; ++round) {
    const std::size_t wanted = random.Below(all->size());
    const auto frames = std::make_shared<std::vector<std::uint64_t>>(1, (*all)[wanted].frame);
    const std::uint64_t before = file_->bytes_read();
    RunReader reader(*file_, extent, frames, ErrorCode::kCorruptInput);
    bool found = false;
    for (BlockReservoirs block;;) {
      const auto more = reader.Next(block);
      ASSERT_TRUE(more) << more.error().message;
      if (!*more) break;
      found |= block.block == samples.blocks[wanted].block &&
               block.cells.size() == samples.blocks[wanted].cells.size();
    }
    EXPECT_TRUE(found) << "seed 63, block " << wanted;
    EXPECT_LT(file_->bytes_read() - before, extent.bytes / 8);
  }
}

TEST_F(RunIndexes, MergedTellTheCellsOfAll) {
  const Samples whole = SheetAndDust(64);
  std::vector<RunExtent> extents;
  TestRandom random(65);
  for (int run = 0; run < 5; ++run) {
    std::vector<BlockReservoirs> part;
    for (const BlockReservoirs& block : whole.blocks) {
      BlockReservoirs some{block.block, {}};
      for (std::size_t c = 0; c < block.cells.size(); ++c) {
        if (run == static_cast<int>(c % 5) || random.Below(7) == 0) {
          some.cells.push_back(block.cells[c]);
        }
      }
      if (!some.cells.empty()) part.push_back(std::move(some));
    }
    extents.push_back(Write(*file_, part));
  }
  std::vector<std::unique_ptr<RunIndex>> indexes;
  for (const RunExtent& extent : extents) indexes.push_back(*Open(*file_, extent));
  MergedIndex merged(indexes);
  IndexedBlock block;
  for (const BlockReservoirs& expected : whole.blocks) {
    const auto more = merged.Next(block);
    ASSERT_TRUE(more && *more);
    ASSERT_EQ(block.block, expected.block);
    ASSERT_EQ(CellsIn(block.cells), expected.cells.size());
  }
  EXPECT_FALSE(*merged.Next(block));
}

TEST_F(RunIndexes, SayHowFarSamplesLieOutsideTheirBlocks) {
  for (const auto& [x, expected] : {std::pair{0.5, 0u},
                                    {-0.4999, 0u},
                                    {-0.51, 1u},
                                    {7.0, 0u},
                                    {8.2, 1u},
                                    {15.0, 1u},
                                    {16.0, 2u},
                                    {1e300, 0xffffffffu}}) {
    BlockReservoirs block{{1, -2, 3}, {{0, {}}}};
    block.cells[0].reservoir.local = {0, x, 0};
    const auto index = Open(*file_, Write(*file_, {block}));
    ASSERT_TRUE(index);
    EXPECT_EQ((*index)->spread(), expected) << x;
  }
}

TEST_F(RunIndexes, OfDamagedRunsAreRefusedOrRight) {
  const Samples samples = SheetAndDust(66);
  const RunExtent extent = Write(*file_, samples.blocks);
  std::string bytes(extent.bytes, 0);
  ASSERT_TRUE(file_->ReadAt(0, bytes));
  TestRandom random(67);
  std::size_t refused = 0;
  for (int round = 0; round < 400; ++round) {
    std::string damaged = bytes;
    // Half of the rounds near the end, where the directory stands.
    const std::size_t at =
        round % 2 == 0 ? random.Below(bytes.size()) : bytes.size() - 1 - random.Below(300);
    if (round % 4 < 2) {
      damaged[at] = static_cast<char>(damaged[at] ^ (1 << random.Below(8)));
    } else {
      damaged.resize(at);
    }
    const auto file = NewFile();
    ASSERT_TRUE(file->Append(damaged));
    const auto index = Open(*file, {0, damaged.size(), 0, 0});
    Result<std::vector<IndexedBlock>> read;
    if (index) read = All(**index);
    if (!index || !read) {
      const Error& error = index ? read.error() : index.error();
      EXPECT_EQ(error.code, ErrorCode::kCorruptInput) << error.message;
      ++refused;
      continue;
    }
    EXPECT_EQ(read->size(), samples.blocks.size()) << "seed 67, byte " << at;
  }
  EXPECT_GT(refused, 200u);
}

}  // namespace
}  // namespace strata::test
