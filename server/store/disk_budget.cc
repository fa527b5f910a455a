#include "server/store/disk_budget.h"

#include <algorithm>

namespace strata::server {

DiskShare& DiskShare::operator=(DiskShare&& other) noexcept {
  if (this != &other) {
    if (budget_ != nullptr) budget_->Return(bytes_);
    budget_ = std::exchange(other.budget_, nullptr);
    bytes_ = std::exchange(other.bytes_, 0);
  }
  return *this;
}

DiskShare::~DiskShare() {
  if (budget_ != nullptr) budget_->Return(bytes_);
}

bool DiskShare::Grow(std::uint64_t bytes) {
  if (!budget_->Take(bytes)) return false;
  bytes_ += bytes;
  return true;
}

void DiskShare::Keep(std::uint64_t bytes) { budget_->Settle(std::exchange(bytes_, 0), bytes); }

bool DiskBudget::Take(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  const std::uint64_t used = shares_ + on_disk_;
  if (used > limit_ || bytes > limit_ - used) return false;
  shares_ += bytes;
  return true;
}

void DiskBudget::Return(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  shares_ -= bytes;
}

void DiskBudget::Settle(std::uint64_t share, std::uint64_t kept) {
  const std::lock_guard lock(mutex_);
  shares_ -= share;
  on_disk_ += kept;
}

void DiskBudget::SetOnDisk(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  on_disk_ = bytes;
}

DiskShare DiskBudget::TakeAnyway(std::uint64_t bytes) {
  DiskShare share(this);
  const std::lock_guard lock(mutex_);
  shares_ += bytes;
  share.bytes_ = bytes;
  return share;
}

void DiskBudget::Add(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  on_disk_ += bytes;
}

void DiskBudget::Remove(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  on_disk_ -= std::min(on_disk_, bytes);
}

std::uint64_t DiskBudget::used() const {
  const std::lock_guard lock(mutex_);
  return shares_ + on_disk_;
}

tl::unexpected<Error> DiskBudget::FailOver(std::uint64_t wanted) const {
  const std::uint64_t in_use = used();
  return Fail(ErrorCode::kOverBudget, "disk for " + what_ + ": " + std::to_string(wanted) +
                                          " bytes wanted, " +
                                          std::to_string(limit_ - std::min(limit_, in_use)) +
                                          " left of " + std::to_string(limit_));
}

}  // namespace strata::server
