#include "server/store/disk_budget.h"

#include <algorithm>

namespace strata::server {

DiskShare& DiskShare::operator=(DiskShare&& other) noexcept {
  if (this != &other) {
    if (budget_ != nullptr) budget_->Remove(bytes_);
    budget_ = std::exchange(other.budget_, nullptr);
    bytes_ = std::exchange(other.bytes_, 0);
  }
  return *this;
}

DiskShare::~DiskShare() {
  if (budget_ != nullptr) budget_->Remove(bytes_);
}

bool DiskShare::Grow(std::uint64_t bytes) {
  if (!budget_->Take(bytes)) return false;
  bytes_ += bytes;
  return true;
}

void DiskShare::Keep(std::uint64_t bytes) {
  budget_->Remove(bytes_ - bytes);
  bytes_ = 0;
}

bool DiskBudget::Take(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  if (used_ > limit_ || bytes > limit_ - used_) return false;
  used_ += bytes;
  return true;
}

DiskShare DiskBudget::TakeAnyway(std::uint64_t bytes) {
  Add(bytes);
  DiskShare share(this);
  share.bytes_ = bytes;
  return share;
}

void DiskBudget::Add(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  used_ += bytes;
}

void DiskBudget::Remove(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  used_ -= std::min(used_, bytes);
}

std::uint64_t DiskBudget::used() const {
  const std::lock_guard lock(mutex_);
  return used_;
}

tl::unexpected<Error> DiskBudget::FailOver(std::uint64_t wanted) const {
  const std::uint64_t in_use = used();
  return Fail(ErrorCode::kOverBudget, "disk for " + what_ + ": " + std::to_string(wanted) +
                                          " bytes wanted, " +
                                          std::to_string(limit_ - std::min(limit_, in_use)) +
                                          " left of " + std::to_string(limit_));
}

}  // namespace strata::server
