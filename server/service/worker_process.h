// A child process that runs jobs: started, told, heard, and always waited for.
#pragma once

#include <sys/types.h>

#include <optional>
#include <string>

#include "core/result.h"
#include "io/fd.h"
#include "strata/internal/worker.pb.h"

namespace strata::server {

/// The internal command with which the program starts itself again for its jobs.
inline constexpr const char* kWorkerCommand = "run-job";

/// The program's own binary as a worker (server/service/worker.h), in a process group of its own.
/// It dies with the thread that started it. Threads: one.
class WorkerProcess {
 public:
  WorkerProcess() = default;
  WorkerProcess(const WorkerProcess&) = delete;
  WorkerProcess& operator=(const WorkerProcess&) = delete;
  /// Kills what still runs.
  ~WorkerProcess() { Kill(); }

  /// The child inherits these two files (-1: none) and nothing else. Errors: kIo.
  Result<void> Start(int mesh, int result);
  bool started() const { return id_ > 0; }
  pid_t id() const { return id_; }

  /// Hands over a job. A child that is gone shows at the end of its events.
  void Send(const internal::WorkerJob& job);
  /// No job follows: the child ends after the last.
  void EndJobs();
  /// The next event, if there is one within `wait_ms`.
  std::optional<internal::WorkerEvent> Next(int wait_ms);
  /// Whether the child's events have come to their end.
  bool ended() const { return ended_; }

  /// Its status as waitpid gives it, once its events have ended; if it runs on even so, it is
  /// killed. Precondition: started.
  int Wait();
  /// Ends it if it runs. It can be started again.
  void Kill();

 private:
  int Spawn(int socket, int mesh, int result);
  std::optional<internal::WorkerEvent> Parse();

  pid_t id_ = -1;
  io::Fd socket_;
  std::string buffer_;
  bool ended_ = false;
};

}  // namespace strata::server
