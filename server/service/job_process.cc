#include "server/service/job_process.h"

#include <fcntl.h>
#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/util/delimited_message_util.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <optional>
#include <string>
#include <utility>

#include "io/fd.h"
#include "io/output_place.h"
#include "server/service/worker.h"

namespace strata::server {
namespace {

using SteadyClock = std::chrono::steady_clock;
constexpr int kTickMs = 50;

tl::unexpected<Error> SystemFailure(const std::string& what, int error) {
  return Fail(ErrorCode::kIo, what + ": " + io::SystemReason(error));
}

/// Above the numbers that the child gets, so that none is overwritten before it is copied.
io::Fd OutOfTheWay(int fd) { return io::Fd(fcntl(fd, F_DUPFD_CLOEXEC, 16)); }

struct Pipe {
  io::Fd read, write;
};

Result<Pipe> MakePipe() {
  std::array<int, 2> ends;
  if (pipe2(ends.data(), O_CLOEXEC) != 0) return SystemFailure("cannot make a pipe", errno);
  const io::Fd low_read(ends[0]), low_write(ends[1]);
  return Pipe{OutOfTheWay(ends[0]), OutOfTheWay(ends[1])};
}

/// The child: started, told its job, read event by event, and always waited for.
class Child {
 public:
  ~Child() {
    if (id_ > 0) {
      kill(id_, SIGKILL);
      static_cast<void>(Wait());
    }
  }

  Result<void> Start(const internal::WorkerJob& job, int mesh, int result) {
    auto told = MakePipe(), heard = MakePipe();
    if (!told) return Forward(told);
    if (!heard) return Forward(heard);
    const io::Fd mesh_copy = OutOfTheWay(mesh), result_copy = OutOfTheWay(result);
    const int failed =
        Spawn({told->read.get(), heard->write.get(), mesh_copy.get(), result_copy.get()});
    if (failed != 0) return SystemFailure("cannot start a worker", failed);
    heard->write.Close();
    told->read.Close();
    events_ = std::move(heard->read);
    fcntl(events_.get(), F_SETFL, O_NONBLOCK);
    std::uint64_t written = 0;
    // A child that is gone already shows at the end of its events.
    static_cast<void>(io::WriteAll(told->write.get(), job.SerializeAsString(), written));
    return {};
  }

  /// Waits a tick at most. The next event, if there is one.
  std::optional<internal::WorkerEvent> Next() {
    if (auto event = Parse()) return event;
    pollfd waited = {events_.get(), POLLIN, 0};
    if (poll(&waited, 1, kTickMs) <= 0) return std::nullopt;
    std::array<char, 4096> bytes;
    const ssize_t n = read(events_.get(), bytes.data(), bytes.size());
    if (n > 0) buffer_.append(bytes.data(), static_cast<std::size_t>(n));
    if (n == 0) ended_ = true;
    return Parse();
  }
  bool ended() const { return ended_; }

  int Wait() {
    int status = 0;
    while (waitpid(id_, &status, 0) < 0 && errno == EINTR) {
    }
    id_ = -1;
    return status;
  }

 private:
  /// Descriptors for 0, 1, kWorkerMesh and kWorkerResult of the child. Returns 0 or an errno.
  int Spawn(const std::array<int, 4>& descriptors) {
    constexpr std::array<int, 4> kNumbers = {0, 1, kWorkerMesh, kWorkerResult};
    posix_spawn_file_actions_t actions;
    posix_spawnattr_t attributes;
    posix_spawn_file_actions_init(&actions);
    posix_spawnattr_init(&attributes);
    for (std::size_t i = 0; i < descriptors.size(); ++i) {
      posix_spawn_file_actions_adddup2(&actions, descriptors[i], kNumbers[i]);
    }
    sigset_t none, usual;
    sigemptyset(&none);
    sigemptyset(&usual);
    sigaddset(&usual, SIGPIPE);
    posix_spawnattr_setsigmask(&attributes, &none);
    posix_spawnattr_setsigdefault(&attributes, &usual);
    // A group of its own: Ctrl-C in the server's terminal is the server's to handle.
    posix_spawnattr_setpgroup(&attributes, 0);
    posix_spawnattr_setflags(
        &attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
    std::string name = "strata", command = kWorkerCommand;
    std::array<char*, 3> arguments = {name.data(), command.data(), nullptr};
    const int failed =
        posix_spawn(&id_, "/proc/self/exe", &actions, &attributes, arguments.data(), environ);
    posix_spawnattr_destroy(&attributes);
    posix_spawn_file_actions_destroy(&actions);
    if (failed != 0) id_ = -1;
    return failed;
  }

  std::optional<internal::WorkerEvent> Parse() {
    google::protobuf::io::ArrayInputStream stream(buffer_.data(), static_cast<int>(buffer_.size()));
    internal::WorkerEvent event;
    bool clean_end = false;
    if (!google::protobuf::util::ParseDelimitedFromZeroCopyStream(&event, &stream, &clean_end)) {
      return std::nullopt;
    }
    buffer_.erase(0, static_cast<std::size_t>(stream.ByteCount()));
    return event;
  }

  pid_t id_ = -1;
  io::Fd events_;
  std::string buffer_;
  bool ended_ = false;
};

Error ErrorOfEnd(const internal::WorkerJob& job, int status) {
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGXCPU) {
    return {ErrorCode::kOverBudget, "the job used up its processor time"};
  }
  if (WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL) {
    return {ErrorCode::kOverBudget,
            "the system ended the job, most likely because memory was short; it may use " +
                std::to_string(job.memory_bytes()) + " bytes"};
  }
  const std::string how = WIFSIGNALED(status)
                              ? "signal " + std::to_string(WTERMSIG(status))
                              : "exit status " + std::to_string(WEXITSTATUS(status));
  return {ErrorCode::kInternal, "the process that sampled " + job.input_name() + " ended with " +
                                    how + "; no other job is touched"};
}

Result<v1::SampleSummary> Finish(const internal::WorkerEvent& last) {
  if (last.has_done()) return last.done();
  const auto code = last.failed().code();
  return Fail(code < kErrorCodeCount ? static_cast<ErrorCode>(code) : ErrorCode::kInternal,
              last.failed().message());
}

}  // namespace

Result<v1::SampleSummary> RunJobIsolated(const internal::WorkerJob& job, int mesh, int result,
                                         const JobWatch& watch) {
  const auto start = SteadyClock::now();
  Child child;
  if (auto started = child.Start(job, mesh, result); !started) return Forward(started);
  while (!child.ended()) {
    if (const auto event = child.Next()) {
      if (!event->has_progress()) {
        if (auto kept = CheckJobLimits(job, result, 0); !kept) return Forward(kept);
        return Finish(*event);
      }
      if (watch.progress) watch.progress(event->progress());
    }
    const double seconds = std::chrono::duration<double>(SteadyClock::now() - start).count();
    if (auto kept = CheckJobLimits(job, result, seconds); !kept) return Forward(kept);
    if (watch.gone && watch.gone()) return Cancelled();
  }
  return tl::unexpected<Error>(ErrorOfEnd(job, child.Wait()));
}

}  // namespace strata::server
