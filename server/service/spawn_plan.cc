#include "server/service/spawn_plan.h"

#include <fcntl.h>
#include <signal.h>
#include <unistd.h>

namespace strata::server {

SpawnPlan::SpawnPlan() {
  posix_spawn_file_actions_init(&actions_);
  posix_spawnattr_init(&attributes_);
  sigset_t none, usual;
  sigemptyset(&none);
  sigemptyset(&usual);
  sigaddset(&usual, SIGPIPE);
  posix_spawnattr_setsigmask(&attributes_, &none);
  posix_spawnattr_setsigdefault(&attributes_, &usual);
  posix_spawnattr_setpgroup(&attributes_, 0);
  posix_spawnattr_setflags(&attributes_,
                           POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
}

SpawnPlan::~SpawnPlan() {
  posix_spawnattr_destroy(&attributes_);
  posix_spawn_file_actions_destroy(&actions_);
}

void SpawnPlan::Give(const io::Fd& fd, int number) {
  if (fd) posix_spawn_file_actions_adddup2(&actions_, fd.get(), number);
}

int SpawnPlan::Run(std::vector<std::string> arguments, pid_t& id,
                   std::vector<std::string> environment) {
  arguments.insert(arguments.begin(), "strata");
  std::vector<char*> pointers, variables;
  pointers.reserve(arguments.size() + 1);
  variables.reserve(environment.size() + 1);
  for (std::string& argument : arguments) pointers.push_back(argument.data());
  for (std::string& variable : environment) variables.push_back(variable.data());
  for (char** each = environ; *each != nullptr; ++each) variables.push_back(*each);
  for (std::vector<char*>* const list : {&pointers, &variables}) list->push_back(nullptr);
  return posix_spawn(&id, "/proc/self/exe", &actions_, &attributes_, pointers.data(),
                     variables.data());
}

io::Fd OutOfTheWay(int fd) { return io::Fd(fcntl(fd, F_DUPFD_CLOEXEC, 16)); }

}  // namespace strata::server
