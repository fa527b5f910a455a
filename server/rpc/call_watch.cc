#include "server/rpc/call_watch.h"

namespace strata::server {

CallWatch::Transfer::Transfer(CallWatch& watch, grpc::ServerContextBase& context)
    : watch_(watch), context_(context) {
  const std::lock_guard lock(watch_.mutex_);
  place_ = watch_.transfers_.insert(watch_.transfers_.end(), this);
}

CallWatch::Transfer::~Transfer() {
  const std::lock_guard lock(watch_.mutex_);
  watch_.transfers_.erase(place_);
}

CallWatch::CallWatch(const Rate& rate) : rate_(rate), thread_([this] { Look(); }) {}

CallWatch::~CallWatch() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  wake_.notify_one();
  thread_.join();
}

bool CallWatch::IsTooSlow(Transfer& transfer) const {
  constexpr double kMessage = 1 << 20;
  const auto now = std::chrono::steady_clock::now();
  const std::uint64_t bytes = transfer.bytes_;
  if (bytes != transfer.seen_) {
    transfer.seen_ = bytes;
    transfer.moved_ = now;
  }
  const auto rate = static_cast<double>(rate_.bytes_per_second);
  const std::chrono::duration<double> whole = now - transfer.start_ - rate_.grace;
  const std::chrono::duration<double> silence = now - transfer.moved_ - rate_.grace;
  return whole.count() * rate > static_cast<double>(bytes) || silence.count() * rate > kMessage;
}

void CallWatch::Look() {
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, std::chrono::seconds(1), [this] { return stopped_; })) {
    for (Transfer* const transfer : transfers_) {
      if (transfer->too_slow_ || !IsTooSlow(*transfer)) continue;
      transfer->too_slow_ = true;
      transfer->context_.TryCancel();
    }
  }
}

}  // namespace strata::server
