#include "tests/support/process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <stdexcept>
#include <utility>

namespace strata::test {
namespace {

void Check(bool holds, const char* what) {
  if (!holds) throw std::runtime_error(what);
}

std::vector<char*> Pointers(std::vector<std::string>& strings) {
  std::vector<char*> pointers;
  for (std::string& s : strings) pointers.push_back(s.data());
  pointers.push_back(nullptr);
  return pointers;
}

constexpr uid_t kNobody = 65534;

// Between fork and exec only async-signal-safe calls are allowed. The program is already open,
// since a user without rights might not reach its folder.
[[noreturn]] void Become(int program, char* const* arguments, const Child::Setup& setup) {
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) {
    signal(number, number == setup.ignored_signal ? SIG_IGN : SIG_DFL);
  }
  if (setup.address_space_bytes > 0) {
    const rlimit space = {setup.address_space_bytes, setup.address_space_bytes};
    if (setrlimit(RLIMIT_AS, &space) != 0) _exit(126);
  }
  if (setup.without_rights && geteuid() == 0) {
    if (setgid(kNobody) != 0 || setuid(kNobody) != 0) _exit(126);
  }
  for (const int stream : setup.closed) close(stream);
  fexecve(program, arguments, environ);
  _exit(127);
}

}  // namespace

ScratchFolder::ScratchFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "strata-test-XXXXXX").string();
  Check(mkdtemp(name.data()) != nullptr, "cannot make a scratch folder");
  path_ = name;
  std::filesystem::permissions(path_, std::filesystem::perms(0755));
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

std::vector<std::string> ScratchFolder::Names() const {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(path_)) {
    names.push_back(entry.path().filename().string());
  }
  std::ranges::sort(names);
  return names;
}

void WriteFile(const std::string& path, const std::string& bytes) {
  std::ofstream file(path, std::ios::binary);
  file << bytes;
  Check(file.good(), "cannot write a test's file");
}

Child::Child(const std::string& program, const std::vector<std::string>& arguments,
             const Setup& setup) {
  signal(SIGPIPE, SIG_IGN);  // A child that ends early shows in Feed.
  std::vector<std::string> words = {program};
  words.insert(words.end(), arguments.begin(), arguments.end());
  const std::vector<char*> pointers = Pointers(words);
  std::array<int, 2> ends{};
  Check(pipe2(ends.data(), O_CLOEXEC) == 0, "cannot make a pipe");
  const int executable = open(program.c_str(), O_RDONLY | O_CLOEXEC);
  Check(executable >= 0, "cannot open the program");
  const int out = open((scratch_ / "out").c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0644);
  const int err = open((scratch_ / "err").c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0644);
  id_ = fork();
  if (id_ == 0) {
    dup2(ends[0], 0), dup2(out, 1), dup2(err, 2);
    Become(executable, pointers.data(), setup);
  }
  for (const int fd : {ends[0], out, err, executable}) close(fd);
  input_ = ends[1];
  Check(id_ > 0, "cannot fork");
}

Child::~Child() {
  CloseInput();
  if (id_ > 0) {
    kill(id_, SIGKILL);
    waitpid(id_, nullptr, 0);
  }
}

bool Child::Feed(const std::string& bytes) {
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t n = write(input_, bytes.data() + done, bytes.size() - done);
    if (n <= 0) return false;
    done += static_cast<std::size_t>(n);
  }
  return true;
}

void Child::CloseInput() {
  if (input_ >= 0) close(std::exchange(input_, -1));
}

void Child::Signal(int number) const { kill(id_, number); }

bool Child::EndsWithin(double seconds) const {
  const int handle = static_cast<int>(syscall(SYS_pidfd_open, id_, 0));
  Check(handle >= 0, "cannot watch the child");
  pollfd ended = {handle, POLLIN, 0};
  const auto whole = static_cast<std::time_t>(seconds);
  const timespec time = {whole, static_cast<long>((seconds - static_cast<double>(whole)) * 1e9)};
  const int ready = ppoll(&ended, 1, &time, nullptr);
  close(handle);
  return ready > 0;
}

int Child::Wait() {
  int status = 0;
  Check(waitpid(std::exchange(id_, -1), &status, 0) > 0, "cannot wait for the child");
  return WIFEXITED(status) ? WEXITSTATUS(status) : 1000 + WTERMSIG(status);
}

Outcome Run(const std::string& program, const std::vector<std::string>& arguments,
            const std::string& input, const Child::Setup& setup) {
  Child child(program, arguments, setup);
  child.Feed(input);
  child.CloseInput();
  const int status = child.Wait();
  return {status, child.Out(), child.Err()};
}

}  // namespace strata::test
