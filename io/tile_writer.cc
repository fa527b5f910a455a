#include <algorithm>
#include <cmath>
#include <memory>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "core/cell_octree.h"
#include "io/atomic_file.h"
#include "io/atomic_folder.h"
#include "io/checked_writer.h"
#include "io/draco_cloud.h"
#include "io/float_grid.h"
#include "io/format_writers.h"
#include "io/output_place.h"
#include "io/row_spooler.h"
#include "io/stored_zip.h"
#include "io/tile_place.h"
#include "io/tile_scatter.h"
#include "io/tileset_json.h"

namespace strata::io {
namespace {

// A tile is named for its place in the octree: its level, and its coordinates in nodes of that.
std::string TilePath(const OctreeNode& node) {
  const Cell cell = CellOfCode(node.first);
  std::string path = std::string(kTilesFolder) + "/" + std::to_string(node.level);
  for (const std::int64_t at : {cell.x, cell.y, cell.z}) {
    path += "_" + std::to_string(at >> node.level);
  }
  return path + ".drc";
}

const Bounds& SurfaceOf(const SampleHeader& header) {
  return header.surface.empty() ? header.bounds : header.surface;
}

// The level of the widest octree node that may be a tile.
int WidestLevel(const SampleHeader& header) {
  const double step = LargestGridStep(SurfaceOf(header), header.position_error);
  const double cells = kMostTileSteps * step / header.edge;
  return cells > 1 ? std::min(std::ilogb(cells), 31) : 0;
}

// For the widest tile that there can be.
std::uint64_t EncoderBytes(const SampleHeader& header, std::uint64_t samples) {
  const Bounds& box = SurfaceOf(header);
  double extent = 0;
  for (int a = 0; a < 3; ++a) extent = std::max(extent, box.max[a] - box.min[a]);
  extent = std::min(extent, std::ldexp(header.edge, WidestLevel(header)));
  const double steps = 2 * extent / LargestGridStep(box, header.position_error);
  int bits = 1;
  while (bits < FloatGrid::kMaxBits && std::ldexp(1.0, bits) < steps + 4) ++bits;
  return DracoEncoderBytes(header, samples, bits);
}

OctreePlan PlanFor(const SampleHeader& header, std::uint64_t tile_samples) {
  const OctreeLimits limits{.most = tile_samples, .widest_level = WidestLevel(header)};
  if (!header.parcels.empty()) return {limits, header.parcels};
  return {limits, OctreePlan::StartLevel(SurfaceOf(header), header.edge)};
}

class TileWriter final : public CheckedWriter {
 public:
  TileWriter(std::unique_ptr<TilePlace> place, const SampleHeader& header,
             const TileLattice& lattice, RowSpooler rows, const WriterResources& resources)
      : CheckedWriter(place->name(), header),
        place_(std::move(place)),
        lattice_(lattice),
        rows_(std::move(rows)),
        plan_(PlanFor(header, resources.tile_samples)),
        resources_(resources) {}

 protected:
  Result<void> Append(const SampleColumns& columns) override try {
    if (auto inside = CheckInside(columns); !inside) return inside;
    if (columns.cell.empty()) return Append(WithCells(columns));
    for (const Cell cell : columns.cell) {
      if (plan_.Add(CodeOf(cell))) continue;
      return Fail(ErrorCode::kInternal, name() + ": a sample lies outside all parcels");
    }
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
    return place_->Finish(entries_);
  } catch (const std::bad_alloc&) {
    return FailMemory();
  }

 private:
  tl::unexpected<Error> FailMemory() const {
    return Fail(ErrorCode::kOverBudget, name() + ": out of memory for the tiles of " +
                                            std::to_string(header().count) +
                                            " samples; larger tiles are fewer");
  }

  SampleColumns WithCells(SampleColumns columns) const {
    for (const Vec3& p : columns.position) {
      columns.cell.push_back(CellAt(p, header().lattice_origin, header().edge));
    }
    return columns;
  }

  CellCode CodeOfRow(const char* row) const { return CodeOf(rows_.layout().CellOf(row)); }

  RowReader AllRows() {
    return {rows_.spool(), rows_.layout(), 0, header().count, resources_.context};
  }

  Result<void> SettlePlan() {
    for (plan_.Settle(); plan_.unsettled(); plan_.Settle()) {
      auto counted = AllRows().ForEach([&](const char* row) { plan_.Add(CodeOfRow(row)); });
      if (!counted) return counted;
    }
    return {};
  }

  std::uint64_t LargestTile() const {
    std::uint64_t largest = 0;
    for (const OctreeNode& tile : plan_.nodes()) largest = std::max(largest, tile.count);
    return largest;
  }

  // From the order in which the samples came to tile after tile, each in that order.
  Result<void> Scatter() {
    // What one spool gives back the other takes: no second share of the memory.
    auto spool =
        Spool::Open(resources_.scratch, nullptr, header().count * rows_.layout().bytes(), name());
    if (!spool) return Forward(spool);
    by_tile_ = std::move(*spool);
    boxes_.resize(plan_.nodes().size());
    TileScatter scatter(*by_tile_, rows_.layout(), plan_.nodes());
    const std::size_t row_bytes = rows_.layout().bytes();
    std::uint64_t done = 0;
    auto moved = AllRows().ForEachPortion([&](std::span<const char> rows) -> Result<void> {
      for (std::size_t at = 0; at < rows.size(); at += row_bytes) {
        const std::size_t tile = plan_.NodeOf(CodeOfRow(rows.data() + at));
        boxes_[tile].Add(rows_.layout().Position(rows.data() + at));
        if (auto put = scatter.Put(tile, rows.data() + at); !put) return put;
      }
      rows_.spool().DiscardBefore(done += rows.size());
      return {};
    });
    if (!moved) return moved;
    return scatter.Finish();
  }

  Result<void> WriteTiles() {
    std::uint64_t first = 0;
    for (std::size_t k = 0; k < plan_.nodes().size(); ++k) {
      const std::uint64_t count = plan_.nodes()[k].count;
      RowReader rows(*by_tile_, rows_.layout(), first, count, resources_.context);
      if (auto written = WriteTile(k, rows); !written) return written;
      rows.Discard();
      first += count;
    }
    return {};
  }

  Result<void> WriteTile(std::size_t k, const RowReader& rows) {
    const std::string path = TilePath(plan_.nodes()[k]);
    const auto grid = TileGrid(lattice_, boxes_[k], name() + ": " + path);
    if (!grid) return Forward(grid);
    const auto bytes = EncodeDracoCloud(rows, *grid, header(), name() + ": " + path);
    if (!bytes) return Forward(bytes);
    auto entry = TileEntry({path, rows.count(), *bytes}, *grid, boxes_[k]);
    if (!entry) return Forward(entry);
    entries_.push_back(std::move(*entry));
    return place_->AddTile(path, {bytes->data(), bytes->size()});
  }

  std::unique_ptr<TilePlace> place_;
  TileLattice lattice_;
  RowSpooler rows_;                 // As they came.
  std::unique_ptr<Spool> by_tile_;  // The same rows, tile after tile.
  OctreePlan plan_;
  std::vector<Bounds> boxes_;         // Of each tile's samples.
  std::vector<std::string> entries_;  // Of the manifest.
  WriterResources resources_;
};

// A folder of tiles that appears whole.
class WholeFolder final : public TilePlace {
 public:
  WholeFolder(std::unique_ptr<AtomicFolder> folder, std::string head)
      : folder_(std::move(folder)), head_(std::move(head)) {}

  Result<void> AddTile(const std::string& path, std::string_view bytes) override {
    if (!std::exchange(has_tiles_, true)) {
      if (auto made = folder_->AddFolder(kTilesFolder); !made) return made;
    }
    return folder_->AddFile(path, bytes);
  }
  Result<std::uint64_t> Finish(const std::vector<std::string>& entries) override {
    auto done = folder_->AddFile(kTilesetName, TilesetText(head_, entries));
    if (done) done = folder_->Finish();
    if (!done) return Forward(done);
    return folder_->size();
  }
  const std::string& name() const override { return folder_->name(); }

 private:
  std::unique_ptr<AtomicFolder> folder_;
  std::string head_;
  bool has_tiles_ = false;
};

// The folder's files in a zip, for what can only be one file.
class ZippedFolder final : public TilePlace {
 public:
  ZippedFolder(std::unique_ptr<AtomicFile> file, std::string head)
      : file_(std::move(file)), zip_(*file_), head_(std::move(head)) {}

  Result<void> Open() { return zip_.Open(); }
  Result<void> AddTile(const std::string& path, std::string_view bytes) override {
    if (auto begun = zip_.Begin(path, bytes.size()); !begun) return begun;
    return zip_.Put({bytes.data(), bytes.size()});
  }
  Result<std::uint64_t> Finish(const std::vector<std::string>& entries) override {
    auto done = AddTile(kTilesetName, TilesetText(head_, entries));
    if (done) done = zip_.Close();
    if (!done) return Forward(done);
    return file_->Finish();
  }
  const std::string& name() const override { return file_->name(); }

 private:
  std::unique_ptr<AtomicFile> file_;
  StoredZip zip_;
  std::string head_;
};

Result<std::unique_ptr<TilePlace>> OpenZippedFolder(const std::string& path, std::string head) {
  auto file = AtomicFile::Open(path);
  if (!file) return Forward(file);
  auto folder = std::make_unique<ZippedFolder>(std::move(*file), std::move(head));
  if (auto opened = folder->Open(); !opened) return Forward(opened);
  return folder;
}

Result<std::unique_ptr<TilePlace>> OpenWholeFolder(const std::string& path, std::string head) {
  auto folder = AtomicFolder::Open(path, kTilesetName);
  if (!folder) return Forward(folder);
  return std::make_unique<WholeFolder>(std::move(*folder), std::move(head));
}

}  // namespace

Result<void> CheckTiles(const std::string& name, const SampleHeader& header,
                        const WriterResources& resources) {
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
  const auto lattice = ChooseTileLattice(SurfaceOf(header), header.position_error, name);
  if (!lattice) return Forward(lattice);
  return CheckEncoderMemory(resources.memory, EncoderBytes(header, resources.tile_samples), name);
}

Result<std::string> HeadOfTiles(const std::string& name, const SampleHeader& header,
                                std::uint64_t tile_samples) {
  const auto lattice = ChooseTileLattice(SurfaceOf(header), header.position_error, name);
  if (!lattice) return Forward(lattice);
  return TilesetHead(header, tile_samples, lattice->step);
}

Result<std::unique_ptr<SampleWriter>> MakeTileWriter(std::unique_ptr<TilePlace> place,
                                                     const SampleHeader& header,
                                                     const WriterResources& resources) {
  const auto lattice = ChooseTileLattice(SurfaceOf(header), header.position_error, place->name());
  if (!lattice) return Forward(lattice);
  // Rows carry the cell, whether the file will or not.
  SampleHeader of_rows = header;
  of_rows.attributes |= kCell;
  auto rows = RowSpooler::Open(of_rows, resources, place->name());
  if (!rows) return Forward(rows);
  return std::make_unique<TileWriter>(std::move(place), header, *lattice, std::move(*rows),
                                      resources);
}

Result<std::unique_ptr<SampleWriter>> MakeFolderWriter(const std::string& path,
                                                       const SampleHeader& header,
                                                       const WriterResources& resources) {
  const bool in_zip = IsWrittenThrough(path);
  if (in_zip && !resources.tiles_in_zip) {
    return Fail(ErrorCode::kInvalidArgument,
                (path == "-" ? "standard output" : path) + ": " + std::to_string(header.count) +
                    " samples, but one drc holds " + std::to_string(resources.tile_samples) +
                    ", and more become a folder, which needs a name; use larger tiles, or ply");
  }
  if (auto checked = CheckTiles(path, header, resources); !checked) return Forward(checked);
  auto head = HeadOfTiles(path, header, resources.tile_samples);
  if (!head) return Forward(head);
  auto place =
      in_zip ? OpenZippedFolder(path, std::move(*head)) : OpenWholeFolder(path, std::move(*head));
  if (!place) return Forward(place);
  return MakeTileWriter(std::move(*place), header, resources);
}

}  // namespace strata::io
