#include "server/remote/backoff.h"

#include <algorithm>
#include <thread>

namespace strata::server {

using std::chrono::milliseconds;

Backoff::Backoff(int max_attempts, std::function<bool()> cancelled)
    : max_attempts_(max_attempts),
      cancelled_(std::move(cancelled)),
      random_(std::random_device()()) {}

bool Backoff::Wait(std::optional<std::chrono::seconds> wished) {
  if (++failed_ >= max_attempts_) return false;
  const int most = std::min(20'000, 100 << std::min(failed_ - 1, 10));
  milliseconds left(std::uniform_int_distribution<int>(most / 2, most)(random_));
  if (wished) left = std::max<milliseconds>(left, std::min(*wished, std::chrono::seconds(60)));
  while (left.count() > 0) {
    if (cancelled_ && cancelled_()) return false;
    const milliseconds nap = std::min(left, milliseconds(100));
    std::this_thread::sleep_for(nap);
    left -= nap;
  }
  return !cancelled_ || !cancelled_();
}

}  // namespace strata::server
