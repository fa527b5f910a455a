// What the Draco writers share: samples on their way into a spool, and the encoder's memory.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/memory_account.h"
#include "core/samples.h"
#include "io/sample_rows.h"
#include "io/sample_writer.h"
#include "io/spool.h"

namespace strata::io {

/// Packs columns into rows and appends them to a spool of its own. Memory: 64 KiB and the spool's.
class RowSpooler {
 public:
  /// For header.count rows. Errors: kOverBudget, kIo.
  static Result<RowSpooler> Open(const SampleHeader& header, const WriterResources& resources,
                                 const std::string& name);

  Result<void> Append(const SampleColumns& columns);
  Spool& spool() { return *spool_; }
  const RowLayout& layout() const { return layout_; }

 private:
  RowSpooler(const RowLayout& layout, std::unique_ptr<Spool> spool)
      : layout_(layout), spool_(std::move(spool)) {}

  RowLayout layout_;
  std::unique_ptr<Spool> spool_;
  std::vector<char> portion_;
};

/// The bytes that `count` rows take. Errors: kOverBudget when no file could hold them.
Result<std::uint64_t> SpoolBytes(const SampleHeader& header, const std::string& name);

/// Takes `bytes` (DracoEncoderBytes) for encoding; `memory` may be null. Errors: kOverBudget,
/// saying how many bytes that is.
Result<MemoryShare> TakeEncoderMemory(MemoryAccount* memory, std::uint64_t bytes,
                                      const std::string& name);
/// Whether the whole budget would be enough for that. Errors: kOverBudget.
Result<void> CheckEncoderMemory(const MemoryAccount* memory, std::uint64_t bytes,
                                const std::string& name);

}  // namespace strata::io
