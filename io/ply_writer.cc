#include <bit>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "io/carried_columns.h"
#include "io/checked_writer.h"
#include "io/format_writers.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little, "rows are copied as they lie in memory");

// The largest integer up to which a double holds every one.
constexpr std::uint64_t kExactInDouble = std::uint64_t{1} << 53;

// PLY has no 64-bit integers: a double holds those up to 2^53.
const char* TypeName(ScalarType type) {
  constexpr const char* kNames[] = {"char", "uchar",  "short",  "ushort", "int",
                                    "uint", "double", "double", "float",  "double"};
  return kNames[static_cast<std::size_t>(type)];
}

bool IsWide(ScalarType type) { return type == ScalarType::kInt64 || type == ScalarType::kUint64; }

// What the columns are, and what the numbers in them are called.
std::string CarriedComments(const SampleHeader& header) {
  std::string text;
  for (const MeshAttribute& column : header.carried) {
    text += "\ncomment column " + ColumnJson(column);
    for (std::size_t k = 0; k < column.names.size(); ++k) {
      text += "\ncomment name " + column.name + " " + std::to_string(k) + " " +
              NameJson(column.names[k]);
    }
  }
  return text;
}

std::string CarriedProperties(const SampleHeader& header) {
  std::string text;
  const auto names = ComponentNames(header.carried);
  for (std::size_t k = 0; k < names.size(); ++k) {
    for (const std::string& name : names[k]) {
      text += std::string("property ") + TypeName(header.carried[k].type) + " " + name + "\n";
    }
  }
  return text;
}

std::string HeaderText(const SampleHeader& header) {
  const auto has = [&](Attribute a) { return (header.attributes & a) != 0; };
  std::string text = "ply\nformat binary_little_endian 1.0\ncomment strata " + header.provenance;
  text += CarriedComments(header);
  text += "\nelement vertex " + std::to_string(header.count);
  text += "\nproperty double x\nproperty double y\nproperty double z\n";
  if (has(kNormal)) text += "property float nx\nproperty float ny\nproperty float nz\n";
  if (has(kTriangle)) text += "property double triangle\n";
  if (has(kBarycentric)) text += "property double b0\nproperty double b1\nproperty double b2\n";
  if (has(kCell)) text += "property int cell_x\nproperty int cell_y\nproperty int cell_z\n";
  if (has(kArea)) text += "property double area\n";
  if (has(kWeight)) text += "property double weight\n";
  text += CarriedProperties(header);
  return text + "end_header\n";
}

class PlyWriter final : public FileWriter {
 public:
  PlyWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header)
      : FileWriter(std::move(file), header) {
    std::size_t bytes = kFixedBytes;
    for (const MeshAttribute& column : header.carried) bytes += column.bytes();
    row_.resize(bytes);
  }

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
    std::memcpy(row_.data() + size_, &value, sizeof value);
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
    if (has(kWeight)) Put(columns.weight[i]);
    for (std::size_t k = 0; k < header().carried.size(); ++k) {
      const MeshAttribute& column = header().carried[k];
      auto put = PutCarried(column, columns.carried[k].data() + i * column.bytes());
      if (!put) return put;
    }
    return file().Write({row_.data(), size_});
  }

  Result<void> PutCarried(const MeshAttribute& column, const char* value) {
    if (!IsWide(column.type)) {
      std::memcpy(row_.data() + size_, value, column.bytes());
      size_ += column.bytes();
      return {};
    }
    for (int c = 0; c < column.components; ++c, value += sizeof(std::uint64_t)) {
      std::uint64_t bits;
      std::memcpy(&bits, value, sizeof bits);
      const bool negative = column.type == ScalarType::kInt64 && (bits >> 63) != 0;
      const std::uint64_t magnitude = negative ? -bits : bits;
      if (magnitude > kExactInDouble) {
        return Fail(ErrorCode::kOverBudget, name() + ": a value of '" + column.name + "', " +
                                                (negative ? "-" : "") + std::to_string(magnitude) +
                                                ", is beyond 2^53, the last that PLY's double "
                                                "holds exactly; use npz");
      }
      Put(negative ? -static_cast<double>(magnitude) : static_cast<double>(magnitude));
    }
    return {};
  }

  static constexpr std::size_t kFixedBytes =
      sizeof(Vec3) + sizeof(Vec3f) + 6 * sizeof(double) + sizeof(Cell);
  std::vector<char> row_;
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
