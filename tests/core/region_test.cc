// Regions of a merge decide together exactly what one merge decides.
#include "core/region.h"

#include <gtest/gtest.h>

#include <set>

#include "tests/support/block_samples.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/rejection_oracle.h"
#include "tests/support/temp_folder.h"

namespace strata::test {
namespace {

constexpr std::uint64_t kSeed = 71;

class Regions : public testing::Test {
 protected:
  void SetUp() override {
    auto opened = ScratchFolder::Open(folder_.path());
    ASSERT_TRUE(opened) << opened.error().message;
    scratch_ = std::move(*opened);
    options_.lattice = {{-0.3, 5, 1e3}, 0.7};
    options_.surface = {{-1e3, -1e3, -1e3}, {2e3, 2e3, 2e3}};
    options_.attributes = kCell;
    options_.parcel_cells = 200;
  }

  // The samples, dealt out: a cell is in one partial with its sample, and sometimes in another one
  // with a later arrival.
  std::vector<Partial> Deal(const Samples& samples, std::size_t count, TestRandom& random) {
    std::vector<std::vector<BlockReservoirs>> dealt(count);
    for (const BlockReservoirs& block : samples.blocks) {
      std::vector<BlockReservoirs> split(count, {block.block, {}});
      for (const BlockReservoirs::Entry& entry : block.cells) {
        const std::size_t winner = random.Below(count);
        split[winner].cells.push_back(entry);
        const std::size_t loser = random.Below(count);
        if (loser == winner || random.Below(3) > 0) continue;
        split[loser].cells.push_back(entry);
        split[loser].cells.back().reservoir.time += 1;
      }
      for (std::size_t p = 0; p < count; ++p) {
        if (!split[p].cells.empty()) dealt[p].push_back(std::move(split[p]));
      }
    }
    std::vector<Partial> parts;
    for (const auto& blocks : dealt) parts.push_back(Write(blocks));
    return parts;
  }

  Partial Write(const std::vector<BlockReservoirs>& blocks) {
    auto file = scratch_->NewFile();
    EXPECT_TRUE(file);
    VectorStream stream(blocks);
    RunWriter writer([&](std::string_view bytes) { return (*file)->Append(bytes); }, 0, false);
    const auto extent = writer.WriteAll(stream, nullptr);
    EXPECT_TRUE(extent);
    Partial partial;
    partial.file = std::move(*file);
    partial.run = *extent;
    return partial;
  }

  // The cells whose samples survive in each region in turn. Every region's are in order, and none
  // is in two.
  std::vector<Cell> Survivors(std::span<const Partial> parts, std::uint32_t count) {
    std::vector<Cell> all;
    std::uint64_t cells = 0;
    for (std::uint32_t r = 0; r < count; ++r) {
      RunContext context;
      context.SetScratch(scratch_.get());
      auto gathered = GatherPartials(parts, {r, count}, options_, context);
      EXPECT_TRUE(gathered) << gathered.error().message;
      if (!gathered) return {};
      cells += gathered->cells;
      EXPECT_EQ(gathered->samples == nullptr, gathered->parcels.empty());
      if (!gathered->samples) continue;
      std::uint64_t survivors = 0;
      SampleColumns columns;
      while (*gathered->samples->Next(columns)) {
        all.insert(all.end(), columns.cell.begin(), columns.cell.end());
        survivors += columns.size();
      }
      EXPECT_EQ(survivors, gathered->survivors);
    }
    cells_ = cells;
    std::sort(all.begin(), all.end());
    EXPECT_EQ(std::adjacent_find(all.begin(), all.end()), all.end());
    return all;
  }

  // What one merge leaves, by the rule for all samples at once or one sample at a time.
  std::vector<Cell> Expected(const Samples& samples, bool one_at_a_time) const {
    std::vector<Vec3> position;
    std::vector<double> time;
    std::vector<Cell> cell, kept;
    for (const BlockReservoirs& block : samples.blocks) {
      for (const auto& [offset, r] : block.cells) {
        cell.push_back(CellOf(block.block, offset));
        time.push_back(r.time);
        position.push_back(PositionOf(options_, cell.back(), r));
      }
    }
    const double distance = options_.min_distance * options_.lattice.edge;
    const auto fate = one_at_a_time ? RejectOneAtATime({position, time, cell}, distance)
                                    : AtOnce(samples, options_);
    for (std::size_t i = 0; i < fate.size(); ++i) {
      if (fate[i] == kSurvivingSample) kept.push_back(cell[i]);
    }
    std::sort(kept.begin(), kept.end());
    return kept;
  }

  TempFolder folder_;
  std::unique_ptr<ScratchFolder> scratch_;
  GatherOptions options_;
  std::uint64_t cells_ = 0;
};

TEST_F(Regions, EqualOneMergeForEveryNumberDistanceAndDeal) {
  for (const int tilt : {0, 2}) {
    for (const double m : {0.0, 0.5, 0.75, 0.9, 2.0, 4.0}) {
      TestRandom random(kSeed);
      const Samples samples(Sheet(90, tilt, random));
      options_.min_distance = m;
      const auto expected = Expected(samples, false);
      for (const std::uint32_t count : {1u, 2u, 3u, 7u}) {
        SCOPED_TRACE("seed 71, tilt " + std::to_string(tilt) + ", m " + std::to_string(m) + ", " +
                     std::to_string(count) + " regions");
        const auto parts = Deal(samples, 1 + count % 3, random);
        EXPECT_TRUE(Survivors(parts, count) == expected);
        EXPECT_EQ(cells_, samples.count);
      }
    }
  }
}

TEST_F(Regions, EqualTheRuleOneSampleAtATime) {
  for (const double m : {0.5, 0.9, 2.0}) {
    TestRandom random(kSeed + 1);
    const Samples samples(Sheet(26, 1, random));
    options_.min_distance = m;
    options_.parcel_cells = 30;
    const auto parts = Deal(samples, 2, random);
    for (const std::uint32_t count : {2u, 5u}) {
      EXPECT_TRUE(Survivors(parts, count) == Expected(samples, true)) << "seed 72, m " << m;
    }
  }
}

// A few samples lie up to `spread` blocks outside the block of their cell.
TEST_F(Regions, EqualOneMergeWhereSamplesLeaveTheirCells) {
  options_.samples_leave_cells = true;
  for (const double spread : {0.0, 1.0, 2.0, 5.0}) {
    for (const double m : {0.0, 0.5, 0.9, 4.0}) {
      TestRandom random(kSeed + 2);
      auto cells = Sheet(80, 2, random);
      for (auto& [cell, r] : cells) {
        const double far = random.Below(50) == 0 ? 8 * spread : 0.3;
        r.local = r.local + random.InBox({-far, -far, -far}, {far, far, far});
      }
      const Samples samples(cells);
      options_.min_distance = m;
      const auto parts = Deal(samples, 2, random);
      for (const std::uint32_t count : {3u, 7u}) {
        EXPECT_TRUE(Survivors(parts, count) == Expected(samples, false))
            << "seed 73, spread " << spread << ", m " << m << ", " << count << " regions";
      }
    }
  }
}

TEST_F(Regions, MayBeMoreThanThereAreParcels) {
  TestRandom random(kSeed + 3);
  const Samples samples(Sheet(20, 1, random));
  const auto parts = Deal(samples, 2, random);
  EXPECT_TRUE(Survivors(parts, 100) == Expected(samples, false));
}

TEST_F(Regions, DoNotReadWhatIsFarAway) {
  TestRandom random(kSeed + 4);
  const Samples samples(Sheet(400, 1, random));
  options_.parcel_cells = 2000;
  const std::vector<Partial> parts = Deal(samples, 2, random);
  for (const double m : {0.0, 0.5}) {
    options_.min_distance = m;
    std::uint64_t most = 0;
    for (std::uint32_t r = 0; r < 16; ++r) {
      const std::uint64_t before = parts[0].file->bytes_read();
      RunContext context;
      context.SetScratch(scratch_.get());
      ASSERT_TRUE(GatherPartials(parts, {r, 16}, options_, context));
      most = std::max(most, parts[0].file->bytes_read() - before);
    }
    std::printf("m %.1f: one of 16 regions reads up to %.3f of a part\n", m,
                static_cast<double>(most) / static_cast<double>(parts[0].run.bytes));
    EXPECT_LT(most, parts[0].run.bytes / 2);
  }
}

TEST_F(Regions, SayWhatMemoryAComponentNeeds) {
  TestRandom random(kSeed + 5);
  const Samples samples(Sheet(300, 1, random));
  const auto parts = Deal(samples, 1, random);
  options_.min_distance = 2;
  RunContext context(2 << 20);
  context.SetScratch(scratch_.get());
  const auto gathered = GatherPartials(parts, {0, 4}, options_, context);
  ASSERT_FALSE(gathered);
  EXPECT_EQ(gathered.error().code, ErrorCode::kOverBudget);
  EXPECT_NE(gathered.error().message.find("need at least"), std::string::npos)
      << gathered.error().message;
}

TEST(ParcelsOfRegions, AreEachInOneRegionAndBalanced) {
  std::vector<OctreeNode> parcels;
  TestRandom random(kSeed + 6);
  std::uint64_t total = 0;
  for (std::size_t p = 0; p < 1000; ++p) {
    parcels.push_back({CellCode{p} << 9, 3, 1 + random.Below(100)});
    total += parcels.back().count;
  }
  for (const std::uint32_t count : {1u, 2u, 7u, 100u, 999u, 5000u}) {
    std::size_t next = 0;
    for (std::uint32_t r = 0; r < count; ++r) {
      const auto mine = ParcelsOf({r, count}, parcels);
      if (mine.empty()) continue;
      ASSERT_EQ(mine.data(), &parcels[next]);
      next += mine.size();
      std::uint64_t cells = 0;
      for (const OctreeNode& parcel : mine) cells += parcel.count;
      EXPECT_LE(cells, total / count + 200);
    }
    EXPECT_EQ(next, parcels.size()) << count;
  }
}

}  // namespace
}  // namespace strata::test
