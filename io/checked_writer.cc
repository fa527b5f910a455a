#include "io/checked_writer.h"

#include <cmath>

namespace strata::io {
namespace {

// The name of a column whose length is wrong, or null.
const char* WrongColumn(const SampleColumns& columns, const SampleHeader& header) {
  const std::size_t n = columns.size();
  const std::size_t sizes[] = {columns.normal.size(),      columns.triangle.size(),
                               columns.barycentric.size(), columns.cell.size(),
                               columns.area.size(),        columns.weight.size()};
  for (std::size_t k = 0; k < kAttributeNames.size(); ++k) {
    const bool wanted = (header.attributes >> k & 1) != 0;
    // A column that was not asked for may be there: it is left out of the file.
    if (wanted && sizes[k] != n) return kAttributeNames[k];
  }
  for (std::size_t k = 0; k < header.carried.size(); ++k) {
    const MeshAttribute& column = header.carried[k];
    const bool there = k < columns.carried.size();
    if (!there || columns.carried[k].size() != n * column.bytes()) return column.name.c_str();
  }
  return nullptr;
}

bool AllFinite(const std::vector<Vec3>& positions) {
  // A sum of products with zero is zero exactly when every factor is finite.
  double sum = 0;
  for (const Vec3& p : positions) sum += p.x * 0 + p.y * 0 + p.z * 0;
  return sum == 0;
}

}  // namespace

tl::unexpected<Error> CheckedWriter::FailInternal(const std::string& what) const {
  return Fail(ErrorCode::kInternal, name_ + ": " + what);
}

Result<void> CheckedWriter::Write(const SampleColumns& columns) {
  if (const char* wrong = WrongColumn(columns, header_)) {
    return FailInternal(std::string("the column '") + wrong + "' does not have one value for " +
                        "each of " + std::to_string(columns.size()) + " samples");
  }
  if (columns.size() > header_.count - written_) {
    return FailInternal("more samples than the " + std::to_string(header_.count) + " announced");
  }
  if (!AllFinite(columns.position)) return FailInternal("a sample's position is not finite");
  written_ += columns.size();
  return columns.size() == 0 ? Result<void>() : Append(columns);
}

Result<std::uint64_t> CheckedWriter::Finish() {
  if (written_ != header_.count) {
    return FailInternal(std::to_string(written_) + " samples written, " +
                        std::to_string(header_.count) + " announced");
  }
  return Complete();
}

Result<void> CheckedWriter::CheckInside(const SampleColumns& columns) const {
  const Bounds& box = header_.bounds;
  bool inside = true;
  for (const Vec3& p : columns.position) {
    for (int a = 0; a < 3; ++a) inside = inside && box.min[a] <= p[a] && p[a] <= box.max[a];
  }
  return inside ? Result<void>() : FailInternal("a sample lies outside the header's bounds");
}

}  // namespace strata::io
