// Samples that lie in memory, on their way out.
#pragma once

#include <utility>

#include "core/memory_account.h"
#include "core/samples.h"

namespace strata {

/// Gives all of its columns at once. `share` is their memory, given back with the source.
class HeldSamples final : public SampleSource {
 public:
  HeldSamples(SampleColumns columns, MemoryShare share)
      : columns_(std::move(columns)), share_(std::move(share)) {}
  Result<bool> Next(SampleColumns& out) override {
    if (columns_.size() == 0) return false;
    out = std::exchange(columns_, {});
    return true;
  }

 private:
  SampleColumns columns_;
  MemoryShare share_;
};

}  // namespace strata
