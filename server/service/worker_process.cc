#include "server/service/worker_process.h"

#include <fcntl.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/util/delimited_message_util.h>
#include <poll.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <utility>

#include "io/output_place.h"
#include "server/service/spawn_plan.h"
#include "server/service/worker.h"

namespace strata::server {
namespace {

constexpr std::size_t kMostEventBytes = std::size_t{16} << 20;

tl::unexpected<Error> SystemFailure(const std::string& what, int error) {
  return Fail(ErrorCode::kIo, what + ": " + io::SystemReason(error));
}

}  // namespace

Result<void> WorkerProcess::Start(int mesh, int result) {
  Kill();
  std::array<int, 2> ends;
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends.data()) != 0) {
    return SystemFailure("cannot make a socket for a worker", errno);
  }
  socket_ = io::Fd(ends[0]);
  const io::Fd childs(ends[1]);
  if (const int failed = Spawn(childs.get(), mesh, result); failed != 0) {
    return SystemFailure("cannot start a worker", failed);
  }
  fcntl(socket_.get(), F_SETFL, O_NONBLOCK);
  ended_ = false;
  buffer_.clear();
  return {};
}

int WorkerProcess::Spawn(int socket, int mesh, int result) {
  const io::Fd socket_copy = OutOfTheWay(socket);
  const io::Fd mesh_copy = mesh < 0 ? io::Fd() : OutOfTheWay(mesh);
  const io::Fd result_copy = result < 0 ? io::Fd() : OutOfTheWay(result);
  SpawnPlan plan;
  plan.Give(socket_copy, 0);
  plan.Give(socket_copy, 1);
  plan.Give(mesh_copy, kWorkerMesh);
  plan.Give(result_copy, kWorkerResult);
  const int failed = plan.Run({kWorkerCommand}, id_);
  if (failed != 0) id_ = -1;
  return failed;
}

void WorkerProcess::Send(const internal::WorkerJob& job) {
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::util::SerializeDelimitedToZeroCopyStream(job, &stream);
  }
  for (std::size_t sent = 0; sent < bytes.size();) {
    const ssize_t n = send(socket_.get(), bytes.data() + sent, bytes.size() - sent, MSG_NOSIGNAL);
    if (n >= 0) {
      sent += static_cast<std::size_t>(n);
    } else if (errno == EAGAIN) {
      // The child reads a job at once, unless it has been stopped: a job then waits in the socket.
      pollfd waited = {socket_.get(), POLLOUT, 0};
      if (poll(&waited, 1, 1000) <= 0) return;
    } else if (errno != EINTR) {
      return;
    }
  }
}

void WorkerProcess::EndJobs() { shutdown(socket_.get(), SHUT_WR); }

std::optional<internal::WorkerEvent> WorkerProcess::Next(int wait_ms) {
  if (auto event = Parse()) return event;
  pollfd waited = {socket_.get(), POLLIN, 0};
  if (poll(&waited, 1, wait_ms) <= 0) return std::nullopt;
  std::array<char, 16384> bytes;
  const ssize_t n = read(socket_.get(), bytes.data(), bytes.size());
  if (n > 0) buffer_.append(bytes.data(), static_cast<std::size_t>(n));
  // What has not become an event by then is not one of ours.
  if (buffer_.size() > kMostEventBytes) ended_ = true;
  // A child that dies with a job unread resets its socket.
  if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) ended_ = true;
  return Parse();
}

std::optional<internal::WorkerEvent> WorkerProcess::Parse() {
  if (buffer_.empty()) return std::nullopt;
  google::protobuf::io::ArrayInputStream stream(buffer_.data(), static_cast<int>(buffer_.size()));
  internal::WorkerEvent event;
  bool clean_end = false;
  if (!google::protobuf::util::ParseDelimitedFromZeroCopyStream(&event, &stream, &clean_end)) {
    return std::nullopt;
  }
  buffer_.erase(0, static_cast<std::size_t>(stream.ByteCount()));
  return event;
}

int WorkerProcess::Wait() {
  // One that ends has closed its socket after its status was settled; one that has merely closed
  // it, or says what nobody understands, would be waited for in vain.
  kill(id_, SIGKILL);
  int status = 0;
  while (waitpid(id_, &status, 0) < 0 && errno == EINTR) {
  }
  id_ = -1;
  return status;
}

void WorkerProcess::Kill() {
  if (id_ > 0) static_cast<void>(Wait());
}

}  // namespace strata::server
