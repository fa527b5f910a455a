#include "server/batch/batch_child.h"

#include <fcntl.h>
#include <linux/close_range.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>

#include "io/fd.h"
#include "io/output_place.h"
#include "server/service/spawn_plan.h"

namespace strata::server {

Result<pid_t> StartBatchChild(const BatchChildPlan& plan) {
  std::vector<std::string> words = {kBatchChildCommand, std::to_string(getpid())};
  words.insert(words.end(), plan.arguments.begin(), plan.arguments.end());
  const io::Fd nothing(open("/dev/null", O_RDONLY | O_CLOEXEC));
  const io::Fd log(open(plan.log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  if (!nothing || !log) return Fail(ErrorCode::kIo, plan.log + ": " + io::SystemReason(errno));
  const io::Fd input = OutOfTheWay(nothing.get()), output = OutOfTheWay(log.get());
  SpawnPlan child;
  child.Give(input, 0);
  child.Give(output, 1);
  child.Give(output, 2);
  pid_t id = -1;
  if (const int failed = child.Run(std::move(words), id, plan.environment); failed != 0) {
    return Fail(ErrorCode::kIo, "cannot start a batch: " + io::SystemReason(failed));
  }
  return id;
}

bool EnterBatchChild(const std::string& parent) {
  // Sockets and files of the parent that were opened without close-on-exec.
  static_cast<void>(syscall(SYS_close_range, 3, ~0u, 0));
  static_cast<void>(prctl(PR_SET_PDEATHSIG, SIGKILL));
  return std::to_string(getppid()) == parent;  // Else it died before it could be asked for.
}

}  // namespace strata::server
