#include "io/assimp_child.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>

#include "io/assimp_stream.h"

namespace strata::io {
namespace {

constexpr int kPollMs = 100;

}  // namespace

AssimpChild::~AssimpChild() {
  if (id_ <= 0) return;
  kill(id_, SIGKILL);
  Reap();
}

Result<void> AssimpChild::Start(const AssimpOrder& order) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return System("pipe");
  pipe_ = Fd(ends[0]);
  const Fd out(ends[1]);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  // By way of high numbers, so that neither overwrites the other.
  posix_spawn_file_actions_adddup2(&actions, order.input, 101);
  posix_spawn_file_actions_adddup2(&actions, out.get(), 102);
  posix_spawn_file_actions_adddup2(&actions, 102, 1);
  posix_spawn_file_actions_adddup2(&actions, 101, kAssimpInput);
  posix_spawn_file_actions_addopen(&actions, 2, "/dev/null", O_WRONLY, 0);
  posix_spawn_file_actions_addclosefrom_np(&actions, kAssimpInput + 1);
  std::string limit = std::to_string(order.memory), suffix = order.suffix, self = order.program;
  std::string run = order.attributes ? kAssimpAttributes : kAssimpSurface;
  char* const arguments[] = {self.data(), limit.data(), suffix.data(), run.data(), nullptr};
  char* const environment[] = {nullptr};
  const int failed =
      posix_spawn(&id_, order.program.c_str(), &actions, nullptr, arguments, environment);
  posix_spawn_file_actions_destroy(&actions);
  if (failed == 0) return {};
  id_ = -1;
  return Fail(ErrorCode::kNotFound, name_ + ": cannot start " + order.program + ": " +
                                        std::generic_category().message(failed));
}

Result<void> AssimpChild::Take(std::span<char> out) {
  while (!out.empty()) {
    if (begin_ == end_) {
      if (auto ok = Fill(); !ok) return ok;
    }
    const std::size_t n = std::min(out.size(), end_ - begin_);
    std::memcpy(out.data(), buffer_.data() + begin_, n);
    begin_ += n;
    out = out.subspan(n);
  }
  return {};
}

tl::unexpected<Error> AssimpChild::System(const char* what) const {
  return Fail(ErrorCode::kIo, name_ + ": " + what + ": " + std::generic_category().message(errno));
}

int AssimpChild::Reap() {
  int status = 0;
  while (waitpid(id_, &status, 0) < 0 && errno == EINTR) {
  }
  id_ = -1;
  return status;
}

Result<void> AssimpChild::Fill() {
  for (;;) {
    if (context_ != nullptr && context_->cancelled()) return Cancelled();
    struct pollfd wait {
      pipe_.get(), POLLIN, 0
    };
    const int ready = poll(&wait, 1, kPollMs);
    if (ready < 0 && errno != EINTR) return System("waiting for the process that reads it");
    if (ready <= 0) continue;
    const ssize_t n = read(pipe_.get(), buffer_.data(), buffer_.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return System("reading from the process that reads it");
    if (n == 0) return Died();
    begin_ = 0;
    end_ = static_cast<std::size_t>(n);
    return {};
  }
}

tl::unexpected<Error> AssimpChild::Died() {
  const int status = id_ > 0 ? Reap() : 0;
  std::string how = "ended too early, with status " + std::to_string(WEXITSTATUS(status));
  if (WIFSIGNALED(status)) {
    const int signal = WTERMSIG(status);
    how = signal == SIGXCPU ? "needed more processor time than it may"
                            : std::string("was killed by signal ") + std::to_string(signal) + " (" +
                                  strsignal(signal) + ")";
  }
  return Fail(ErrorCode::kCorruptInput,
              name_ + ": the process that reads it " + how + ": assimp does not stand this file");
}

}  // namespace strata::io
