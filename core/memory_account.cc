#include "core/memory_account.h"

#include <malloc.h>

namespace strata {

MemoryShare::~MemoryShare() {
  if (account_ != nullptr) account_->taken_.fetch_sub(bytes_, std::memory_order_relaxed);
}

Result<MemoryShare> MemoryAccount::Take(std::uint64_t bytes, const std::string& what) {
  std::uint64_t taken = this->taken();
  do {
    if (taken <= budget_ && bytes <= budget_ - taken) continue;
    return Fail(ErrorCode::kOverBudget,
                what + " need " + std::to_string(bytes) + " bytes beside " + std::to_string(taken) +
                    " in use, but the memory budget is " + std::to_string(budget_) + " bytes");
  } while (!taken_.compare_exchange_weak(taken, taken + bytes, std::memory_order_relaxed));
  return MemoryShare(this, bytes);
}

void ReturnFreedMemory() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

}  // namespace strata
