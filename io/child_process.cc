#include "io/child_process.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace strata::io {
namespace {

// Where descriptors wait: beyond all that are still to be placed, so that none is overwritten.
int WaitingPlace(std::span<const ChildProcess::Opening> openings) {
  int place = 100;
  for (const auto& opening : openings) place = std::max(place, opening.descriptor + 1);
  return place;
}

sigset_t SignalsOfTheGroup() {
  sigset_t set;
  sigemptyset(&set);
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP}) sigaddset(&set, signal);
  return set;
}

}  // namespace

ChildProcess::~ChildProcess() {
  if (id_ <= 0) return;
  kill(id_, SIGKILL);
  Reap();
}

int ChildProcess::Start(const std::string& program, std::vector<std::string> arguments,
                        std::span<const Opening> openings) {
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  const int waiting = WaitingPlace(openings);
  for (const Opening& opening : openings) {
    posix_spawn_file_actions_adddup2(&actions, opening.descriptor, waiting + opening.number);
  }
  int first_free = 3;
  for (int standard = 0; standard < first_free; ++standard) {
    posix_spawn_file_actions_addopen(&actions, standard, "/dev/null", O_RDWR, 0);
  }
  for (const Opening& opening : openings) {
    posix_spawn_file_actions_adddup2(&actions, waiting + opening.number, opening.number);
    first_free = std::max(first_free, opening.number + 1);
  }
  posix_spawn_file_actions_addclosefrom_np(&actions, first_free);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  const sigset_t blocked = SignalsOfTheGroup();
  posix_spawnattr_setsigmask(&attributes, &blocked);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
  arguments.insert(arguments.begin(), program);
  std::vector<char*> words;
  words.reserve(arguments.size() + 1);
  for (std::string& argument : arguments) words.push_back(argument.data());
  words.push_back(nullptr);
  char* const environment[] = {nullptr};
  const int failed =
      posix_spawn(&id_, program.c_str(), &actions, &attributes, words.data(), environment);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) id_ = -1;
  return failed;
}

int ChildProcess::Reap() {
  int status = 0;
  while (waitpid(id_, &status, 0) < 0 && errno == EINTR) {
  }
  id_ = -1;
  return status;
}

std::string ChildProcess::WaitForEnd() {
  if (id_ <= 0) return "is gone";
  const int status = Reap();
  if (!WIFSIGNALED(status)) {
    return "ended too early, with status " + std::to_string(WEXITSTATUS(status));
  }
  const int signal = WTERMSIG(status);
  if (signal == SIGXCPU) return "needed more processor time than it may";
  return "was killed by signal " + std::to_string(signal) + " (" + strsignal(signal) + ")";
}

}  // namespace strata::io
