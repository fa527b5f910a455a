#include "io/sample_rows.h"

#include <bit>

namespace strata::io {
namespace {

constexpr std::array<std::size_t, kAttributeNames.size()> kBytes = {
    sizeof(Vec3f), sizeof(std::uint64_t), sizeof(std::array<double, 3>),
    sizeof(Cell),  sizeof(double),        sizeof(double)};

template <class T>
std::string_view BytesOf(const std::vector<T>& column) {
  return {reinterpret_cast<const char*>(column.data()), column.size() * sizeof(T)};
}

}  // namespace

std::string_view ColumnBytes(const SampleColumns& columns, AttributeSet fixed) {
  switch (fixed) {
    case kNormal:
      return BytesOf(columns.normal);
    case kTriangle:
      return BytesOf(columns.triangle);
    case kBarycentric:
      return BytesOf(columns.barycentric);
    case kCell:
      return BytesOf(columns.cell);
    case kArea:
      return BytesOf(columns.area);
    case kWeight:
      return BytesOf(columns.weight);
    default:
      return BytesOf(columns.position);
  }
}

RowLayout::RowLayout(const SampleHeader& header) : attributes_(header.attributes) {
  for (std::size_t k = 0; k < kBytes.size(); ++k) {
    at_[k] = bytes_;
    if ((attributes_ >> k & 1) != 0) bytes_ += kBytes[k];
  }
  for (const MeshAttribute& column : header.carried) {
    carried_.push_back({bytes_, column.bytes()});
    bytes_ += column.bytes();
  }
}

std::size_t RowLayout::At(Attribute attribute) const {
  return at_[static_cast<std::size_t>(std::countr_zero(static_cast<AttributeSet>(attribute)))];
}

void RowLayout::Pack(const SampleColumns& columns, std::size_t i, char* out) const {
  const auto put = [&](Attribute attribute, const auto& column) {
    if ((attributes_ & attribute) == 0) return;
    std::memcpy(out + At(attribute), &column[i], sizeof column[i]);
  };
  std::memcpy(out, &columns.position[i], sizeof(Vec3));
  put(kNormal, columns.normal);
  put(kTriangle, columns.triangle);
  put(kBarycentric, columns.barycentric);
  put(kCell, columns.cell);
  put(kArea, columns.area);
  put(kWeight, columns.weight);
  for (std::size_t k = 0; k < carried_.size(); ++k) {
    const auto& [at, bytes] = carried_[k];
    std::memcpy(out + at, columns.carried[k].data() + i * bytes, bytes);
  }
}

}  // namespace strata::io
