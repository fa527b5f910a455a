#include "server/rpc/call_watch.h"

namespace strata::server {

CallWatch::Transfer::Transfer(CallWatch& watch, grpc::ServerContext& context)
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

void CallWatch::Look() {
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, std::chrono::seconds(1), [this] { return stopped_; })) {
    const auto now = std::chrono::steady_clock::now();
    for (Transfer* const transfer : transfers_) {
      const std::chrono::duration<double> late = now - transfer->start_ - rate_.grace;
      const double least = late.count() * static_cast<double>(rate_.bytes_per_second);
      if (static_cast<double>(transfer->bytes_) >= least || transfer->too_slow_) continue;
      transfer->too_slow_ = true;
      transfer->context_.TryCancel();
    }
  }
}

}  // namespace strata::server
