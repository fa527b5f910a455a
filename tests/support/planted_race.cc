// A program with a race, to see that the run notices: planted_race race|lock exit|kill. Two threads
// count together, without a lock or with one; then it ends well, or as a service that a test kills.
#include <signal.h>

#include <mutex>
#include <string_view>
#include <thread>

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const bool locked = std::string_view(argv[1]) == "lock";
  const bool killed = std::string_view(argv[2]) == "kill";
  std::mutex mutex;
  int count = 0;
  const auto add = [&] {
    std::unique_lock lock(mutex, std::defer_lock);
    if (locked) lock.lock();
    ++count;
  };
  std::thread one(add), other(add);
  one.join();
  other.join();
  if (killed) raise(SIGKILL);
  return 0;
}
