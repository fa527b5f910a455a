#include "server/service/admission.h"

#include <chrono>
#include <string>
#include <utility>

#include "core/run_context.h"

namespace strata::server {
namespace {
constexpr std::chrono::milliseconds kTick{50};
constexpr int kRetryAfter = 5;  // Seconds; about a job's time.
}  // namespace

Ticket::Ticket(Ticket&& other) noexcept
    : admission_(std::exchange(other.admission_, nullptr)), bytes_(other.bytes_) {}

Ticket& Ticket::operator=(Ticket&& other) noexcept {
  std::swap(admission_, other.admission_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

Ticket::~Ticket() {
  if (admission_) admission_->Leave(bytes_);
}

Answer<Ticket> Admission::Enter(std::uint64_t bytes, const std::function<bool()>& gone, Full full) {
  if (bytes > limits_.memory_bytes) {
    return Refuse(Error{ErrorCode::kOverBudget, "the job asks for " + std::to_string(bytes) +
                                                    " bytes of memory, all jobs together have " +
                                                    std::to_string(limits_.memory_bytes)});
  }
  std::unique_lock lock(mutex_);
  const auto fits = [&] {
    return running_ < limits_.jobs && taken_ + bytes <= limits_.memory_bytes;
  };
  const bool place_left = waiting_.size() < limits_.waiting || (waiting_.empty() && fits());
  if (!place_left && full == Full::kRefuse) {
    return Refuse(Refusal::kUnavailable,
                  std::to_string(waiting_.size()) + " jobs wait already, which is the limit",
                  kRetryAfter);
  }
  const auto place = waiting_.insert(waiting_.end(), next_number_++);
  Tell();
  bool left = false;
  while (!(waiting_.front() == *place && fits())) {
    moved_.wait_for(lock, kTick);
    lock.unlock();
    left = gone && gone();
    lock.lock();
    if (left) break;
  }
  waiting_.erase(place);
  if (!left) {
    ++running_;
    taken_ += bytes;
  }
  Tell();
  moved_.notify_all();
  if (left) return Refuse(Cancelled().value());
  return Ticket(this, bytes);
}

void Admission::Leave(std::uint64_t bytes) {
  const std::lock_guard lock(mutex_);
  --running_;
  taken_ -= bytes;
  Tell();
  moved_.notify_all();
}

}  // namespace strata::server
