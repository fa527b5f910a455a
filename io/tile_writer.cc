#include <algorithm>
#include <cmath>
#include <memory>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "io/atomic_folder.h"
#include "io/checked_writer.h"
#include "io/draco_cloud.h"
#include "io/float_grid.h"
#include "io/format_writers.h"
#include "io/output_place.h"
#include "io/row_spooler.h"
#include "io/tile_plan.h"
#include "io/tile_scatter.h"
#include "io/tileset_json.h"

namespace strata::io {
namespace {

constexpr const char* kTilesFolder = "tiles";
// Up to as many of the largest steps a tile surely has a grid (ChooseTileGrids).
constexpr double kMostSteps = 0x1p21;

std::string TilePath(std::size_t index) {
  std::string digits = std::to_string(index);
  digits.insert(0, digits.size() < 6 ? 6 - digits.size() : 0, '0');
  return std::string(kTilesFolder) + "/" + digits + ".drc";
}

// The level of the widest octree node that may be a tile.
int WidestLevel(const SampleHeader& header) {
  const double step = LargestGridStep(header.bounds, header.position_error);
  const double cells = kMostSteps * step / header.edge;
  return cells > 1 ? std::min(std::ilogb(cells), 31) : 0;
}

// For the widest tile that there can be.
std::uint64_t EncoderBytes(const SampleHeader& header, std::uint64_t samples) {
  const Bounds& box = header.bounds;
  double extent = 0;
  for (int a = 0; a < 3; ++a) extent = std::max(extent, box.max[a] - box.min[a]);
  extent = std::min(extent, std::ldexp(header.edge, WidestLevel(header)));
  const double steps = 2 * extent / LargestGridStep(box, header.position_error);
  int bits = 1;
  while (bits < FloatGrid::kMaxBits && std::ldexp(1.0, bits) < steps + 4) ++bits;
  return DracoEncoderBytes(header.attributes, samples, bits);
}

TilePlan PlanFor(const SampleHeader& header, std::uint64_t tile_samples) {
  return {tile_samples, WidestLevel(header), TilePlan::StartLevel(header.bounds, header.edge)};
}

class TileWriter final : public CheckedWriter {
 public:
  TileWriter(std::unique_ptr<AtomicFolder> folder, const SampleHeader& header, RowSpooler rows,
             const WriterResources& resources)
      : CheckedWriter(folder->name(), header),
        folder_(std::move(folder)),
        rows_(std::move(rows)),
        plan_(PlanFor(header, resources.tile_samples)),
        resources_(resources) {}

 protected:
  Result<void> Append(const SampleColumns& columns) override try {
    if (auto inside = CheckInside(columns); !inside) return inside;
    for (const Vec3& p : columns.position) plan_.Add(CodeAt(p));
    return rows_.Append(columns);
  } catch (const std::bad_alloc&) {
    return FailMemory();
  }

  Result<std::uint64_t> Complete() override try {
    if (auto settled = SettlePlan(); !settled) return Forward(settled);
    const auto share =
        TakeEncoderMemory(resources_.memory, EncoderBytes(header(), LargestTile()), name());
    if (!share) return Forward(share);
    if (auto scattered = Scatter(); !scattered) return Forward(scattered);
    if (auto written = WriteTiles(); !written) return Forward(written);
    if (auto finished = folder_->Finish(); !finished) return Forward(finished);
    return folder_->size();
  } catch (const std::bad_alloc&) {
    return FailMemory();
  }

 private:
  tl::unexpected<Error> FailMemory() const {
    return Fail(ErrorCode::kOverBudget, name() + ": out of memory for the tiles of " +
                                            std::to_string(header().count) +
                                            " samples; larger tiles are fewer");
  }

  CellCode CodeAt(Vec3 position) const {
    return CodeOf(CellAt(position, header().lattice_origin, header().edge));
  }

  RowReader AllRows() {
    return {rows_.spool(), rows_.layout(), 0, header().count, resources_.context};
  }

  Result<void> SettlePlan() {
    for (plan_.Settle(); plan_.unsettled(); plan_.Settle()) {
      auto counted = AllRows().ForEach(
          [&](const char* row) { plan_.Recount(CodeAt(rows_.layout().Position(row))); });
      if (!counted) return counted;
    }
    return {};
  }

  std::uint64_t LargestTile() const {
    std::uint64_t largest = 0;
    for (const TileNode& tile : plan_.tiles()) largest = std::max(largest, tile.count);
    return largest;
  }

  // From the order in which the samples came to tile after tile, each in that order.
  Result<void> Scatter() {
    // What one spool gives back the other takes: no second share of the memory.
    auto spool =
        Spool::Open(resources_.scratch, nullptr, header().count * rows_.layout().bytes(), name());
    if (!spool) return Forward(spool);
    by_tile_ = std::move(*spool);
    TileScatter scatter(*by_tile_, rows_.layout(), plan_.tiles());
    const std::size_t row_bytes = rows_.layout().bytes();
    std::uint64_t done = 0;
    auto moved = AllRows().ForEachPortion([&](std::span<const char> rows) -> Result<void> {
      for (std::size_t at = 0; at < rows.size(); at += row_bytes) {
        const Vec3 position = rows_.layout().Position(rows.data() + at);
        const std::size_t tile = plan_.TileOf(CodeAt(position));
        boxes_.resize(plan_.tiles().size());
        boxes_[tile].Add(position);
        if (auto put = scatter.Put(tile, rows.data() + at); !put) return put;
      }
      rows_.spool().DiscardBefore(done += rows.size());
      return {};
    });
    if (!moved) return moved;
    return scatter.Finish();
  }

  Result<void> WriteTiles() {
    const auto grids = ChooseTileGrids(header().bounds, boxes_, header().position_error, name());
    if (!grids) return Forward(grids);
    if (auto made = folder_->AddFolder(kTilesFolder); !made) return made;
    TilesetJson tileset(header(), resources_.tile_samples, grids->front().step);
    std::uint64_t first = 0;
    for (std::size_t k = 0; k < boxes_.size(); ++k) {
      const std::uint64_t count = plan_.tiles()[k].count;
      RowReader rows(*by_tile_, rows_.layout(), first, count, resources_.context);
      if (auto written = WriteTile(k, rows, (*grids)[k], tileset); !written) return written;
      rows.Discard();
      first += count;
    }
    return folder_->AddFile(kTilesetName, tileset.Finish());
  }

  Result<void> WriteTile(std::size_t k, const RowReader& rows, const FloatGrid& grid,
                         TilesetJson& tileset) {
    const std::string path = TilePath(k);
    const auto bytes = EncodeDracoCloud(rows, grid, header(), name() + ": " + path);
    if (!bytes) return Forward(bytes);
    if (auto added = tileset.Add(path, rows.count(), *bytes, grid, boxes_[k]); !added) return added;
    return folder_->AddFile(path, {bytes->data(), bytes->size()});
  }

  std::unique_ptr<AtomicFolder> folder_;
  RowSpooler rows_;                 // As they came.
  std::unique_ptr<Spool> by_tile_;  // The same rows, tile after tile.
  TilePlan plan_;
  std::vector<Bounds> boxes_;  // Of each tile's samples.
  WriterResources resources_;
};

Result<void> CheckTiled(const std::string& path, const SampleHeader& header,
                        const WriterResources& resources) {
  const std::string name = path == "-" ? "standard output" : path;
  if (IsWrittenThrough(path)) {
    return Fail(ErrorCode::kInvalidArgument,
                name + ": " + std::to_string(header.count) + " samples, but one drc holds " +
                    std::to_string(resources.tile_samples) +
                    ", and more become a folder, which needs a name; use larger tiles, or ply");
  }
  if (resources.tile_samples == 0 || resources.tile_samples > kMostTileSamples) {
    return Fail(ErrorCode::kInvalidArgument,
                name + ": found tiles of " + std::to_string(resources.tile_samples) +
                    " samples, expected 1 to " + std::to_string(kMostTileSamples));
  }
  const Vec3 origin = header.lattice_origin;
  if (!std::isfinite(origin.x + origin.y + origin.z) || !std::isfinite(header.edge) ||
      !(header.edge > 0)) {
    return Fail(ErrorCode::kInternal, name + ": the header's lattice is none");
  }
  return CheckEncoderMemory(resources.memory, EncoderBytes(header, resources.tile_samples), name);
}

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeTileWriter(const std::string& path,
                                                     const SampleHeader& header,
                                                     const WriterResources& resources) {
  if (auto checked = CheckTiled(path, header, resources); !checked) return Forward(checked);
  // The smallest of boxes: is the error possible at all?
  const Bounds corner{header.bounds.min, header.bounds.min};
  const auto grid = ChooseTileGrids(header.bounds, {&corner, 1}, header.position_error, path);
  if (!grid) return Forward(grid);
  auto folder = AtomicFolder::Open(path, kTilesetName);
  if (!folder) return Forward(folder);
  auto rows = RowSpooler::Open(header, resources, path);
  if (!rows) return Forward(rows);
  return std::make_unique<TileWriter>(std::move(*folder), header, std::move(*rows), resources);
}

}  // namespace strata::io
