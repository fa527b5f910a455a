#include "core/signal_shield.h"

#include <ctime>

namespace strata {

SignalShield::SignalShield(std::initializer_list<int> signals) {
  sigemptyset(&set_);
  sigset_t pending;
  sigpending(&pending);
  for (const int number : signals) {
    sigaddset(&set_, number);
    had_pending_ |= sigismember(&pending, number) == 1;
  }
  pthread_sigmask(SIG_BLOCK, &set_, &old_);
}

SignalShield::~SignalShield() {
  const timespec no_wait{};
  while (!had_pending_ && sigtimedwait(&set_, nullptr, &no_wait) > 0) {
  }
  pthread_sigmask(SIG_SETMASK, &old_, nullptr);
}

}  // namespace strata
