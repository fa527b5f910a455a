#include "io/draco_cloud.h"

#include <draco/compression/config/compression_shared.h>
#include <draco/compression/config/encoder_options.h>
#include <draco/core/encoder_buffer.h>
#include <draco/core/status.h>
#include <draco/point_cloud/point_cloud.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <exception>
#include <functional>
#include <limits>
#include <memory>
#include <new>
#include <stdexcept>
#include <utility>

#include "io/carried_columns.h"
#include "io/draco_in_turn.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little, "ids are cut into words as they lie");

constexpr std::int64_t kLayoutVersion = 1;
// Octahedral with 9 bits a coordinate: at most 0.47 degrees off (docs/adr/0004).
constexpr int kNormalBits = 9;
constexpr int kBarycentricBits = 20;
// Beyond these speeds no byte is saved (docs/adr/0004).
constexpr int kSpeed = 5;
// Draco's entropy estimate allocates a table as long as the largest symbol; this keeps it at 512
// MiB.
constexpr std::int64_t kLargestCellRange = std::int64_t{1} << 26;
// The same for integers that the mesh carries: 4 MiB.
constexpr std::int64_t kLargestPackedRange = std::int64_t{1} << 18;
constexpr int kMostDracoComponents = 15;

using draco::AttributeValueIndex;
using draco::GeometryAttribute;

// A float as text that strtof reads back exactly, whatever the locale's decimal point: Draco keeps
// its options as text, and its own setters print six decimals, which is nothing for a small model.
std::string ExactText(double value) {
  int exponent = 0;
  const auto mantissa = static_cast<std::int64_t>(std::ldexp(std::frexp(value, &exponent), 53));
  char text[48];
  std::snprintf(text, sizeof text, "%s0x%llxp%d", mantissa < 0 ? "-" : "",
                static_cast<long long>(std::abs(mantissa)), exponent - 53);
  return text;
}

std::array<float, 3> GridBarycentric(const std::array<double, 3>& weights) {
  std::array<float, 3> rounded;
  for (std::size_t k = 0; k < 3; ++k) {
    const double unit = std::ldexp(1.0, kBarycentricBits);
    const double on_grid = std::floor(std::clamp(weights[k], 0.0, 1.0) * unit + 0.5) / unit;
    rounded[k] = static_cast<float>(on_grid);
  }
  return rounded;
}

// The cloud in the making: its attributes, how each is filled from a row, and what the encoder must
// know of each.
class CloudBuilder {
 public:
  // `wide` tells of each carried column whether its integers are too far apart to be packed.
  CloudBuilder(const RowReader& rows, const FloatGrid& grid, const SampleHeader& header,
               std::vector<bool> wide)
      : rows_(rows), layout_(rows.layout()), grid_(grid), header_(header), wide_(std::move(wide)) {
    options_.SetGlobalInt("encoding_method", draco::POINT_CLOUD_SEQUENTIAL_ENCODING);
    options_.SetSpeed(kSpeed, kSpeed);
    AddMetadata();
    AddPosition();
    AddAttributes();
    // Only now: attributes added to a cloud of known size get their storage at once.
    cloud_.set_num_points(static_cast<std::uint32_t>(rows.count()));
  }

  Result<void> Encode(draco::EncoderBuffer& buffer, const std::string& name) {
    Result<void> filled;
    const FillAttribute fill = [&](int id, draco::PointAttribute& attribute) {
      filled = Fill(columns_[static_cast<std::size_t>(id)], attribute);
      return filled.has_value();
    };
    const draco::Status status = EncodeInTurn(cloud_, options_, fill, buffer);
    if (!filled) return filled;
    if (status.ok()) return {};
    return Fail(ErrorCode::kInternal, name + ": Draco: " + status.error_msg_string());
  }

  // Whether the decoder gives back every sample at the very position that was encoded.
  Result<bool> DecodesFrom(const draco::EncoderBuffer& buffer) const {
    draco::PointCloud decoded;
    if (!DecodePositions(buffer, decoded).ok() || decoded.num_points() != rows_.count()) {
      return false;
    }
    const auto* positions = decoded.GetNamedAttribute(GeometryAttribute::POSITION);
    if (positions == nullptr || positions->size() != rows_.count()) return false;
    const std::uint8_t* found = positions->GetAddress(AttributeValueIndex(0));
    bool equal = true;
    auto read = rows_.ForEach([&](const char* row) {
      const auto expected = PositionOnGrid(row);
      equal = equal && std::memcmp(found, expected.data(), sizeof expected) == 0;
      found += sizeof expected;
    });
    if (!read) return Forward(read);
    return equal;
  }

 private:
  using PutValue = std::function<void(const char* row, std::uint8_t* out)>;
  struct Column {
    PutValue put;
    std::size_t bytes = 0;
  };

  // `value(row)` gives the N components of a sample.
  template <class T, std::size_t N, class Value>
  int Add(const char* name, GeometryAttribute::Type type, draco::DataType data_type,
          const Value& value) {
    GeometryAttribute description;
    description.Init(type, nullptr, N, data_type, false, N * sizeof(T), 0);
    const int id = cloud_.AddAttribute(description, true, 0);
    auto metadata = std::make_unique<draco::AttributeMetadata>();
    metadata->AddEntryString("name", name);
    cloud_.AddAttributeMetadata(id, std::move(metadata));
    const auto put = [value](const char* row, std::uint8_t* out) {
      const std::array<T, N> components = value(row);
      std::memcpy(out, components.data(), sizeof components);
    };
    columns_.push_back({put, N * sizeof(T)});
    return id;
  }

  Result<void> Fill(const Column& column, draco::PointAttribute& attribute) const {
    std::uint8_t* out = attribute.GetAddress(AttributeValueIndex(0));
    return rows_.ForEach([&](const char* row) {
      column.put(row, out);
      out += column.bytes;
    });
  }

  void QuantizeOnGrid(int id, const FloatGrid& grid) {
    draco::Options options;
    options.SetInt("quantization_bits", grid.bits);
    options.SetString(
        "quantization_origin",
        ExactText(grid.origin.x) + " " + ExactText(grid.origin.y) + " " + ExactText(grid.origin.z));
    options.SetString("quantization_range", ExactText(grid.range()));
    options_.SetAttributeOptions(id, options);
  }

  std::array<float, 3> PositionOnGrid(const char* row) const {
    return grid_.ValueAt(grid_.Quantize(layout_.Position(row)));
  }

  void AddPosition() {
    const int id = Add<float, 3>("position", GeometryAttribute::POSITION, draco::DT_FLOAT32,
                                 [this](const char* row) { return PositionOnGrid(row); });
    QuantizeOnGrid(id, grid_);
  }

  void AddAttributes() {
    const auto has = [this](Attribute a) { return (header_.attributes & a) != 0; };
    if (has(kNormal)) AddNormal();
    if (has(kTriangle)) {
      Add<std::uint16_t, 4>(
          "triangle", GeometryAttribute::GENERIC, draco::DT_UINT16, [this](const char* row) {
            return std::bit_cast<std::array<std::uint16_t, 4>>(layout_.Triangle(row));
          });
    }
    if (has(kBarycentric)) AddBarycentric();
    if (has(kCell)) AddCells();
    if (has(kArea)) {
      Add<float, 1>("area", GeometryAttribute::GENERIC, draco::DT_FLOAT32, [this](const char* row) {
        return std::array{static_cast<float>(layout_.Area(row))};
      });
    }
    if (has(kWeight)) {
      Add<float, 1>(
          "weight", GeometryAttribute::GENERIC, draco::DT_FLOAT32,
          [this](const char* row) { return std::array{static_cast<float>(layout_.Weight(row))}; });
    }
    for (std::size_t k = 0; k < header_.carried.size(); ++k) AddCarried(k);
  }

  // The first colour and the first UV are what viewers take for such.
  GeometryAttribute::Type TypeOf(std::size_t k) const {
    const auto& columns = header_.carried;
    const auto is_first = [&](const auto& is) {
      return is(columns[k]) && std::find_if(columns.begin(), columns.end(), is) ==
                                   columns.begin() + static_cast<std::ptrdiff_t>(k);
    };
    if (is_first([](const MeshAttribute& c) { return IsColor(c.semantic); })) {
      return GeometryAttribute::COLOR;
    }
    if (is_first([](const MeshAttribute& c) { return c.semantic == Semantic::kUv; })) {
      return GeometryAttribute::TEX_COORD;
    }
    return GeometryAttribute::GENERIC;
  }

  void AddCarried(std::size_t k) {
    const MeshAttribute& column = header_.carried[k];
    constexpr draco::DataType kTypes[] = {
        draco::DT_INT8,   draco::DT_UINT8, draco::DT_INT16,  draco::DT_UINT16,  draco::DT_INT32,
        draco::DT_UINT32, draco::DT_INT64, draco::DT_UINT64, draco::DT_FLOAT32, draco::DT_FLOAT64};
    GeometryAttribute description;
    description.Init(TypeOf(k), nullptr, static_cast<std::int8_t>(column.components),
                     kTypes[static_cast<std::size_t>(column.type)], column.normalized,
                     static_cast<std::int64_t>(column.bytes()), 0);
    const int id = cloud_.AddAttribute(description, true, 0);
    auto metadata = std::make_unique<draco::AttributeMetadata>();
    metadata->AddEntryString("name", column.name);
    metadata->AddEntryString("column", ColumnJson(column));
    if (!column.names.empty()) metadata->AddEntryString("names", NamesJson(column));
    cloud_.AddAttributeMetadata(id, std::move(metadata));
    columns_.push_back({[this, k, bytes = column.bytes()](const char* row, std::uint8_t* out) {
                          std::memcpy(out, layout_.Carried(row, k), bytes);
                        },
                        column.bytes()});
    if (wide_.size() <= k || !wide_[k]) return;
    draco::Options options;
    options.SetInt(kRawOption, 1);
    options_.SetAttributeOptions(id, options);
  }

  void AddNormal() {
    const int id = Add<float, 3>("normal", GeometryAttribute::NORMAL, draco::DT_FLOAT32,
                                 [this](const char* row) {
                                   const Vec3f n = layout_.Normal(row);
                                   return std::array{n.x, n.y, n.z};
                                 });
    draco::Options options;
    options.SetInt("quantization_bits", kNormalBits);
    options_.SetAttributeOptions(id, options);
  }

  void AddBarycentric() {
    const int id = Add<float, 3>(
        "barycentric", GeometryAttribute::GENERIC, draco::DT_FLOAT32,
        [this](const char* row) { return GridBarycentric(layout_.Barycentric(row)); });
    FloatGrid grid;
    grid.bits = kBarycentricBits + 1;  // So that 1 itself is on the grid.
    grid.step = std::ldexp(1.0, -kBarycentricBits);
    QuantizeOnGrid(id, grid);
  }

  // One attribute an axis: Draco predicts within the range of the whole attribute, and the axes may
  // lie far from each other.
  void AddCells() {
    const std::pair<const char*, std::int32_t Cell::*> axes[] = {
        {"cell_x", &Cell::x}, {"cell_y", &Cell::y}, {"cell_z", &Cell::z}};
    for (const auto& [name, axis] : axes) {
      Add<std::int32_t, 1>(
          name, GeometryAttribute::GENERIC, draco::DT_INT32,
          [this, axis = axis](const char* row) { return std::array{layout_.CellOf(row).*axis}; });
    }
  }

  void AddMetadata() {
    auto metadata = std::make_unique<draco::GeometryMetadata>();
    metadata->AddEntryInt("strata_layout", kLayoutVersion);
    metadata->AddEntryString("strata", header_.provenance);
    metadata->AddEntryDouble("position_offset_x", grid_.offset.x);
    metadata->AddEntryDouble("position_offset_y", grid_.offset.y);
    metadata->AddEntryDouble("position_offset_z", grid_.offset.z);
    metadata->AddEntryDouble("position_error", header_.position_error);
    metadata->AddEntryDouble("cell_edge", header_.edge);
    cloud_.AddMetadata(std::move(metadata));
  }

  const RowReader& rows_;
  const RowLayout layout_;
  const FloatGrid& grid_;
  const SampleHeader& header_;
  const std::vector<bool> wide_;
  draco::PointCloud cloud_;
  draco::EncoderOptions options_ = draco::EncoderOptions::CreateDefaultOptions();
  std::vector<Column> columns_;  // By attribute id.
};

// The widest spread of the cells along an axis.
Result<std::int64_t> CellRange(const RowReader& rows) {
  constexpr auto kFar = std::numeric_limits<std::int64_t>::max() / 2;
  std::array<std::int64_t, 3> low = {kFar, kFar, kFar}, high = {-kFar, -kFar, -kFar};
  auto read = rows.ForEach([&](const char* row) {
    const Cell cell = rows.layout().CellOf(row);
    const std::array<std::int64_t, 3> at = {cell.x, cell.y, cell.z};
    for (std::size_t a = 0; a < 3; ++a) {
      low[a] = std::min(low[a], at[a]);
      high[a] = std::max(high[a], at[a]);
    }
  });
  if (!read) return Forward(read);
  return std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
}

Result<void> CheckCells(const RowReader& rows, const SampleHeader& header,
                        const std::string& name) {
  if ((header.attributes & kCell) == 0) return {};
  const auto range = CellRange(rows);
  if (!range) return Forward(range);
  if (*range <= kLargestCellRange) return {};
  return Fail(ErrorCode::kOverBudget, name + ": the cells span " + std::to_string(*range) +
                                          " along an axis, Draco's encoder takes up to " +
                                          std::to_string(kLargestCellRange) +
                                          "; leave out the attribute 'cell'");
}

// Whether a carried column's integers are further apart than Draco's table for them should be long.
Result<bool> IsWide(const RowReader& rows, const MeshAttribute& column, std::size_t k) {
  if (column.type != ScalarType::kInt32 && column.type != ScalarType::kUint32) return false;
  const bool is_signed = column.type == ScalarType::kInt32;
  std::int64_t low = std::numeric_limits<std::int64_t>::max() / 2, high = -low;
  auto read = rows.ForEach([&](const char* row) {
    const char* value = rows.layout().Carried(row, k);
    for (int c = 0; c < column.components; ++c, value += sizeof(std::uint32_t)) {
      std::uint32_t bits;
      std::memcpy(&bits, value, sizeof bits);
      const std::int64_t number = is_signed ? static_cast<std::int32_t>(bits) : std::int64_t{bits};
      low = std::min(low, number);
      high = std::max(high, number);
    }
  });
  if (!read) return Forward(read);
  // Draco takes every integer for a signed one.
  return high - low > kLargestPackedRange || high > std::numeric_limits<std::int32_t>::max();
}

Result<std::vector<bool>> FindWide(const RowReader& rows, const SampleHeader& header,
                                   const std::string& name) {
  std::vector<bool> wide;
  for (std::size_t k = 0; k < header.carried.size(); ++k) {
    const MeshAttribute& column = header.carried[k];
    if (column.components > kMostDracoComponents) {
      return Fail(ErrorCode::kOverBudget,
                  name + ": '" + column.name + "' has " + std::to_string(column.components) +
                      " components, Draco takes up to " + std::to_string(kMostDracoComponents) +
                      "; use npz or ply");
    }
    const auto found = IsWide(rows, column, k);
    if (!found) return Forward(found);
    wide.push_back(*found);
  }
  return wide;
}

// The sum of `bytes` over the attributes in the set.
std::uint64_t BytesOf(AttributeSet attributes,
                      const std::array<std::uint64_t, kAttributeNames.size()>& bytes) {
  std::uint64_t sum = 0;
  for (std::size_t k = 0; k < bytes.size(); ++k) {
    if ((attributes >> k & 1) != 0) sum += bytes[k];
  }
  return sum;
}

// More than a sample ever takes in the buffer, what the entropy coder asks for at first included.
std::uint64_t ReservedBytes(AttributeSet attributes) {
  return 24 + BytesOf(attributes, {6, 24, 24, 24, 4, 4});
}

std::uint64_t CarriedBytes(const SampleHeader& header) {
  std::uint64_t bytes = 0;
  for (const MeshAttribute& column : header.carried) bytes += column.bytes();
  return bytes;
}

Result<std::vector<char>> Encode(const RowReader& rows, const FloatGrid& grid,
                                 const SampleHeader& header, const std::string& name) {
  if (auto checked = CheckCells(rows, header, name); !checked) return Forward(checked);
  auto wide = FindWide(rows, header, name);
  if (!wide) return Forward(wide);
  CloudBuilder builder(rows, grid, header, std::move(*wide));
  draco::EncoderBuffer buffer;
  // What is reserved and not touched takes no memory; a buffer that grows takes three times its
  // size while it moves.
  buffer.buffer()->reserve(
      rows.count() * (ReservedBytes(header.attributes) + 3 * CarriedBytes(header)) + (1 << 16));
  if (auto encoded = builder.Encode(buffer, name); !encoded) return Forward(encoded);
  const auto decodes = builder.DecodesFrom(buffer);
  if (!decodes) return Forward(decodes);
  if (*decodes) return std::move(*buffer.buffer());
  return Fail(ErrorCode::kInternal, name + ": Draco's decoder does not give back what was encoded");
}

tl::unexpected<Error> FailMemory(const RowReader& rows, const std::string& name) {
  return Fail(ErrorCode::kOverBudget, name + ": out of memory while encoding " +
                                          std::to_string(rows.count()) +
                                          " samples with Draco; ply and xyz need none");
}

}  // namespace

Result<std::vector<char>> EncodeDracoCloud(const RowReader& rows, const FloatGrid& grid,
                                           const SampleHeader& header,
                                           const std::string& name) try {
  return Encode(rows, grid, header, name);
} catch (const std::bad_alloc&) {
  return FailMemory(rows, name);
} catch (const std::length_error&) {
  return FailMemory(rows, name);
} catch (const std::exception& defect) {
  return Fail(ErrorCode::kInternal, name + ": Draco: " + defect.what());
}

std::uint64_t DracoEncoderBytes(AttributeSet attributes, std::uint64_t count, int position_bits) {
  constexpr std::uint64_t kFixed = std::uint64_t{8} << 20, kPosition = 46;
  // The entropy estimate's table, an int for each value; cells have at most a bit more.
  const std::uint64_t table = std::uint64_t{8} << position_bits;
  return kFixed + table + count * (kPosition + BytesOf(attributes, {4, 24, 16, 6, 4, 4}));
}

std::uint64_t DracoEncoderBytes(const SampleHeader& header, std::uint64_t count,
                                int position_bits) {
  // What was written stays; the largest column is at hand as it is, as integers and as symbols.
  std::uint64_t largest = 0;
  for (const MeshAttribute& column : header.carried) {
    const auto components = static_cast<std::uint64_t>(column.components);
    largest = std::max(largest, column.bytes() + 8 * components);
  }
  return DracoEncoderBytes(header.attributes, count, position_bits) +
         count * (CarriedBytes(header) + largest);
}

}  // namespace strata::io
