#include "server/interrupt.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>

#include "io/atomic_file.h"

namespace strata::server {
namespace {

constexpr std::chrono::milliseconds kForEver{-1};
constexpr std::chrono::milliseconds kPatience{500};
constexpr int kStop = 0, kTimeout = -1;  // No signal has these numbers.

/// Those that the process was not started with as ignored.
sigset_t SignalsToWatch() {
  sigset_t set;
  sigemptyset(&set);
  for (const int number : {SIGINT, SIGTERM, SIGHUP}) {
    struct sigaction action {};
    sigaction(number, nullptr, &action);
    if (action.sa_handler != SIG_IGN) sigaddset(&set, number);
  }
  return set;
}

}  // namespace

InterruptGuard::InterruptGuard(RunContext& context) : context_(context) {
  const sigset_t watched = SignalsToWatch();
  signals_ = signalfd(-1, &watched, SFD_CLOEXEC);
  stop_ = eventfd(0, EFD_CLOEXEC);
  if (signals_ < 0 || stop_ < 0) return;  // The signals then keep their usual effect.
  pthread_sigmask(SIG_BLOCK, &watched, &former_mask_);
  watcher_ = std::thread([this] { Watch(); });
}

InterruptGuard::~InterruptGuard() {
  if (watcher_.joinable()) {
    eventfd_write(stop_, 1);
    watcher_.join();
    pthread_sigmask(SIG_SETMASK, &former_mask_, nullptr);
  }
  if (signals_ >= 0) close(signals_);
  if (stop_ >= 0) close(stop_);
}

void InterruptGuard::Watch() {
  const int first = Next(kForEver);
  if (first <= kStop) return;
  signal_ = first;
  context_.Cancel();
  if (Next(kPatience) == kStop) return;
  io::RemoveUnfinishedOutputs();
  _exit(128 + first);
}

/// The next signal's number, kStop when the guard ends, kTimeout after `timeout`.
int InterruptGuard::Next(std::chrono::milliseconds timeout) const {
  std::array<pollfd, 2> waited = {{{stop_, POLLIN, 0}, {signals_, POLLIN, 0}}};
  while (poll(waited.data(), waited.size(), static_cast<int>(timeout.count())) < 0 &&
         errno == EINTR) {
  }
  if (waited[0].revents != 0) return kStop;
  signalfd_siginfo info{};
  if (waited[1].revents == 0 || read(signals_, &info, sizeof info) != sizeof info) return kTimeout;
  return static_cast<int>(info.ssi_signo);
}

}  // namespace strata::server
