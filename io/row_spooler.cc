#include "io/row_spooler.h"

#include <algorithm>
#include <limits>

namespace strata::io {
namespace {

constexpr std::size_t kPortionBytes = std::size_t{1} << 16;

}  // namespace

Result<std::uint64_t> SpoolBytes(const SampleHeader& header, const std::string& name) {
  const std::uint64_t row = RowLayout(header).bytes();
  if (header.count <= std::numeric_limits<std::int64_t>::max() / row) return header.count * row;
  return Fail(ErrorCode::kOverBudget, name + ": " + std::to_string(header.count) +
                                          " samples are more than a file can hold");
}

Result<RowSpooler> RowSpooler::Open(const SampleHeader& header, const WriterResources& resources,
                                    const std::string& name) {
  const auto bytes = SpoolBytes(header, name);
  if (!bytes) return Forward(bytes);
  auto spool = Spool::Open(resources.scratch, resources.memory, *bytes, name + ": the samples");
  if (!spool) return Forward(spool);
  return RowSpooler(RowLayout(header), std::move(*spool));
}

Result<void> RowSpooler::Append(const SampleColumns& columns) {
  const std::size_t row = layout_.bytes(), rows_at_once = kPortionBytes / row;
  portion_.resize(rows_at_once * row);
  for (std::size_t first = 0; first < columns.size(); first += rows_at_once) {
    const std::size_t n = std::min(rows_at_once, columns.size() - first);
    for (std::size_t i = 0; i < n; ++i) layout_.Pack(columns, first + i, &portion_[i * row]);
    if (auto added = spool_->Append({portion_.data(), n * row}); !added) return added;
  }
  return {};
}

Result<MemoryShare> TakeEncoderMemory(MemoryAccount* memory, std::uint64_t bytes,
                                      const std::string& name) {
  if (memory == nullptr) return MemoryShare();
  return memory->Take(bytes, name + ": Draco's encoder and the check of its work");
}

Result<void> CheckEncoderMemory(const MemoryAccount* memory, std::uint64_t bytes,
                                const std::string& name) {
  if (memory == nullptr || bytes <= memory->budget()) return {};
  return Fail(ErrorCode::kOverBudget, name + ": Draco's encoder needs " + std::to_string(bytes) +
                                          " bytes, but the memory budget is " +
                                          std::to_string(memory->budget()) +
                                          " bytes; use smaller tiles, or ply");
}

}  // namespace strata::io
