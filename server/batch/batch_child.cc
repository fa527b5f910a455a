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

namespace strata::server {
namespace {

/// Between fork and exec, where only what is safe in a signal handler may be called.
[[noreturn]] void Become(char** words, int nothing, int log, pid_t parent) {
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  signal(SIGPIPE, SIG_DFL);
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(127);  // It died before it could be asked for.
  dup2(nothing, 0);
  dup2(log, 1);
  dup2(log, 2);
  syscall(SYS_close_range, 3, ~0u, CLOSE_RANGE_CLOEXEC);
  execv("/proc/self/exe", words);
  _exit(127);
}

}  // namespace

Result<pid_t> StartBatchChild(const BatchChildPlan& plan) {
  std::vector<std::string> words = {"strata"};
  words.insert(words.end(), plan.arguments.begin(), plan.arguments.end());
  std::vector<char*> pointers;
  for (std::string& word : words) pointers.push_back(word.data());
  pointers.push_back(nullptr);
  const io::Fd nothing(open("/dev/null", O_RDONLY | O_CLOEXEC));
  const io::Fd log(open(plan.log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
  if (!nothing || !log) {
    return Fail(ErrorCode::kIo, plan.log + ": " + io::SystemReason(errno));
  }
  const pid_t parent = getpid(), child = fork();
  if (child == 0) Become(pointers.data(), nothing.get(), log.get(), parent);
  if (child < 0) {
    return Fail(ErrorCode::kIo, "cannot start a batch: " + io::SystemReason(errno));
  }
  return child;
}

}  // namespace strata::server
