#include "io/assimp_child.h"

#include <fcntl.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <system_error>

#include "io/assimp_stream.h"

namespace strata::io {
namespace {

constexpr int kPollMs = 100;

}  // namespace

Result<void> AssimpChild::Start(const AssimpOrder& order) {
  int ends[2];
  if (pipe2(ends, O_CLOEXEC) != 0) return System("pipe");
  pipe_ = Fd(ends[0]);
  const Fd out(ends[1]);
  const std::array<ChildProcess::Opening, 2> openings = {
      {{out.get(), 1}, {order.input, kAssimpInput}}};
  const int failed = process_.Start(order.program,
                                    {std::to_string(order.memory), order.suffix,
                                     order.attributes ? kAssimpAttributes : kAssimpSurface},
                                    openings);
  if (failed == 0) return {};
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
  return Fail(ErrorCode::kCorruptInput, name_ + ": the process that reads it " +
                                            process_.WaitForEnd() +
                                            ": assimp does not stand this file");
}

}  // namespace strata::io
