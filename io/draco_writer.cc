#include <array>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "io/checked_writer.h"
#include "io/draco_cloud.h"
#include "io/float_grid.h"
#include "io/format_writers.h"
#include "io/row_spooler.h"

namespace strata::io {
namespace {

std::uint64_t EncoderBytes(const SampleHeader& header, const FloatGrid& grid) {
  return DracoEncoderBytes(header, header.count, grid.bits);
}

class DracoWriter final : public FileWriter {
 public:
  DracoWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header, const FloatGrid& grid,
              RowSpooler rows, const WriterResources& resources)
      : FileWriter(std::move(file), header),
        grid_(grid),
        rows_(std::move(rows)),
        resources_(resources) {}

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    if (auto inside = CheckInside(columns); !inside) return inside;
    return rows_.Append(columns);
  }

  Result<std::uint64_t> Complete() override {
    const auto share = TakeEncoderMemory(resources_.memory, EncoderBytes(header(), grid_), name());
    if (!share) return Forward(share);
    const RowReader rows(rows_.spool(), rows_.layout(), 0, header().count, resources_.context);
    const auto bytes = EncodeDracoCloud(rows, grid_, header(), name());
    if (!bytes) return Forward(bytes);
    if (auto written = file().Write({bytes->data(), bytes->size()}); !written) {
      return Forward(written);
    }
    return file().Finish();
  }

 private:
  FloatGrid grid_;
  RowSpooler rows_;
  WriterResources resources_;
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeDracoWriter(std::unique_ptr<AtomicFile> file,
                                                      const SampleHeader& header,
                                                      const WriterResources& resources) {
  if (header.count > kMostTileSamples) {
    return Fail(ErrorCode::kOverBudget, file->name() + ": " + std::to_string(header.count) +
                                            " samples, Draco takes up to " +
                                            std::to_string(kMostTileSamples) +
                                            "; use smaller tiles, or ply");
  }
  const auto grid = ChooseFloatGrid(header.bounds, header.position_error, file->name());
  if (!grid) return Forward(grid);
  auto possible = CheckEncoderMemory(resources.memory, EncoderBytes(header, *grid), file->name());
  if (!possible) return Forward(possible);
  auto rows = RowSpooler::Open(header, resources, file->name());
  if (!rows) return Forward(rows);
  return std::make_unique<DracoWriter>(std::move(file), header, *grid, std::move(*rows), resources);
}

}  // namespace strata::io
