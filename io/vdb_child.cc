#include "io/vdb_child.h"

#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <system_error>
#include <utility>

#include "core/packing.h"

namespace strata::io {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 18;
constexpr int kPollMs = 100;

std::string Megabytes(std::uint64_t bytes) { return std::to_string((bytes >> 20) + 1) + " MiB"; }

}  // namespace

VdbChild::VdbChild(std::string name, const RunContext* context)
    : name_(std::move(name)), context_(context) {
  buffer_.reserve(kBufferBytes);
}

tl::unexpected<Error> VdbChild::System(const char* what) const {
  return Fail(ErrorCode::kIo, name_ + ": " + what + ": " + std::generic_category().message(errno));
}

Result<void> VdbChild::Start(const std::string& program, VdbHead head, const ScratchFile& output) {
  int ends[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0) {
    return System("a way to the program that writes it");
  }
  socket_ = Fd(ends[0]);
  const Fd theirs(ends[1]);
  disk_ = output.name();
  points_ = head.count;
  memory_bytes_ = head.memory_bytes;
  const std::array<ChildProcess::Opening, 2> openings = {
      {{theirs.get(), 0}, {output.descriptor(), kVdbOutput}}};
  if (const int failed = process_.Start(program, {}, openings); failed != 0) {
    return Fail(ErrorCode::kNotFound, name_ + ": cannot start " + program + ": " +
                                          std::generic_category().message(failed));
  }
  Packer packed;
  PackHead(head, packed);
  Packer front;
  front.Value(static_cast<std::uint64_t>(packed.bytes.size()));
  if (auto sent = Send(front.bytes); !sent) return sent;
  return Send(packed.bytes);
}

// Whether `events` came to be; false: not yet.
Result<bool> VdbChild::Wait(short events) const {
  if (context_ != nullptr && context_->cancelled()) return Cancelled();
  struct pollfd wait {
    socket_.get(), events, 0
  };
  const int ready = poll(&wait, 1, kPollMs);
  if (ready < 0 && errno != EINTR) return System("waiting for the program that writes it");
  return ready > 0;
}

Result<void> VdbChild::Send(std::span<const char> row) {
  if (buffer_.size() + row.size() > kBufferBytes) {
    if (auto flushed = Flush(); !flushed) return flushed;
  }
  buffer_.append(row.data(), row.size());
  return {};
}

Result<void> VdbChild::Flush() {
  for (std::size_t at = 0; at < buffer_.size();) {
    const auto ready = Wait(POLLOUT);
    if (!ready) return Forward(ready);
    if (!*ready) continue;
    const ssize_t n =
        send(socket_.get(), buffer_.data() + at, buffer_.size() - at, MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    // The child left before its time, and may have said why.
    if (n < 0 && (errno == EPIPE || errno == ECONNRESET)) {
      const auto answer = Answer();
      if (!answer) return Forward(answer);
      return Fail(ErrorCode::kInternal, name_ + ": the program that writes it ended too early");
    }
    if (n < 0) return System("writing to the program that writes it");
    at += static_cast<std::size_t>(n);
  }
  buffer_.clear();
  return {};
}

Result<void> VdbChild::Receive(std::span<char> out) {
  while (!out.empty()) {
    const auto ready = Wait(POLLIN);
    if (!ready) return Forward(ready);
    if (!*ready) continue;
    const ssize_t n = recv(socket_.get(), out.data(), out.size(), MSG_DONTWAIT);
    if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (n <= 0) {
      return Fail(ErrorCode::kIo, name_ + ": the program that writes it " + process_.WaitForEnd());
    }
    out = out.subspan(static_cast<std::size_t>(n));
  }
  return {};
}

Result<std::uint64_t> VdbChild::Answer() {
  VdbAnswer answer;
  if (auto ok = Receive({reinterpret_cast<char*>(&answer), sizeof answer}); !ok) return Forward(ok);
  if (answer.kind == VdbAnswer::kDone) return answer.number;
  constexpr std::uint32_t kMostText = 1 << 16;
  std::string text(std::min(answer.text_bytes, kMostText), '\0');
  if (auto ok = Receive(text); !ok) return Forward(ok);
  return Refused(answer, text);
}

tl::unexpected<Error> VdbChild::Refused(const VdbAnswer& answer, const std::string& text) const {
  switch (answer.kind) {
    case VdbAnswer::kOverMemory: {
      const std::string need = answer.number == 0 ? "more" : Megabytes(answer.number);
      return Fail(ErrorCode::kOverBudget, name_ + ": OpenVDB's grid of " + std::to_string(points_) +
                                              " samples needs " + need + ", of the memory budget " +
                                              Megabytes(memory_bytes_) +
                                              " are left for it; ply and npz need little");
    }
    case VdbAnswer::kDisk:
      return Fail(ErrorCode::kIo,
                  "scratch space " + disk_ + ": " +
                      std::generic_category().message(static_cast<int>(answer.number)));
    default:
      return Fail(ErrorCode::kInternal, name_ + ": the program that writes it: " + text);
  }
}

Result<std::uint64_t> VdbChild::Finish() {
  if (auto flushed = Flush(); !flushed) return Forward(flushed);
  return Answer();
}

}  // namespace strata::io
