#include <bit>
#include <cstring>
#include <string>
#include <utility>

#include "io/checked_writer.h"
#include "io/format_writers.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little, "rows are copied as they lie in memory");

// The largest integer up to which a double holds every one.
constexpr std::uint64_t kExactInDouble = std::uint64_t{1} << 53;

std::string HeaderText(const SampleHeader& header) {
  const auto has = [&](Attribute a) { return (header.attributes & a) != 0; };
  std::string text = "ply\nformat binary_little_endian 1.0\ncomment strata " + header.provenance;
  text += "\nelement vertex " + std::to_string(header.count);
  text += "\nproperty double x\nproperty double y\nproperty double z\n";
  if (has(kNormal)) text += "property float nx\nproperty float ny\nproperty float nz\n";
  if (has(kTriangle)) text += "property double triangle\n";
  if (has(kBarycentric)) text += "property double b0\nproperty double b1\nproperty double b2\n";
  if (has(kCell)) text += "property int cell_x\nproperty int cell_y\nproperty int cell_z\n";
  if (has(kArea)) text += "property double area\n";
  return text + "end_header\n";
}

class PlyWriter final : public FileWriter {
 public:
  using FileWriter::FileWriter;

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    for (std::size_t i = 0; i < columns.size(); ++i) {
      auto row = WriteRow(columns, i);
      if (!row) return row;
    }
    return {};
  }

 private:
  template <class T>
  void Put(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    std::memcpy(row_ + size_, &value, sizeof value);
    size_ += sizeof value;
  }

  Result<void> WriteRow(const SampleColumns& columns, std::size_t i) {
    size_ = 0;
    Put(columns.position[i]);
    if (has(kNormal)) Put(columns.normal[i]);
    if (has(kTriangle)) {
      if (columns.triangle[i] > kExactInDouble) {
        return Fail(ErrorCode::kOverBudget,
                    name() + ": triangle " + std::to_string(columns.triangle[i]) +
                        " is beyond 2^53, the last that PLY's double holds exactly; use npz");
      }
      Put(static_cast<double>(columns.triangle[i]));
    }
    if (has(kBarycentric)) Put(columns.barycentric[i]);
    if (has(kCell)) Put(columns.cell[i]);
    if (has(kArea)) Put(columns.area[i]);
    return file().Write({row_, size_});
  }

  char row_[sizeof(Vec3) + sizeof(Vec3f) + 5 * sizeof(double) + sizeof(Cell)];
  std::size_t size_ = 0;
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakePlyWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header) {
  auto written = file->Write(HeaderText(header));
  if (!written) return Forward(written);
  return std::make_unique<PlyWriter>(std::move(file), header);
}

}  // namespace strata::io
