// Running a program as a user would, and looking at what it leaves.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "tests/support/read_text.h"

namespace strata::test {

/// A folder of its own under the system's temporary folder, removed with everything in it.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  std::string operator/(const std::string& name) const { return (path_ / name).string(); }
  const std::filesystem::path& path() const { return path_; }
  /// Names of what lies in it, sorted, hidden files too.
  std::vector<std::string> Names() const;

 private:
  std::filesystem::path path_;
};

void WriteFile(const std::string& path, const std::string& bytes);

/// A child process whose standard input this process feeds, and whose output goes to files.
class Child {
 public:
  struct Setup {
    bool without_rights = false;   ///< Give up root before the program starts.
    int ignored_signal = 0;        ///< Started with this signal ignored, as nohup does; 0 = none.
    std::vector<int> closed = {};  ///< Standard streams (0, 1, 2) that are closed at the start.
    std::uint64_t address_space_bytes = 0;  ///< Limit of what it may map; 0 = none.
  };

  Child(const std::string& program, const std::vector<std::string>& arguments, const Setup& setup);
  Child(const std::string& program, const std::vector<std::string>& arguments)
      : Child(program, arguments, Setup{}) {}
  ~Child();  ///< Kills what still runs.
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  /// Blocks until the pipe has taken everything. False when the child closed it first.
  bool Feed(const std::string& bytes);
  void CloseInput();
  void Signal(int number) const;
  /// Exit status, or 1000 + the signal that killed it. Leaves the input as it is.
  int Wait();

  /// Blocks until the child has ended, at most `seconds`; returns whether it has. Does not reap it.
  bool EndsWithin(double seconds) const;

  pid_t id() const { return id_; }
  std::string Out() const { return ReadText(scratch_ / "out"); }
  std::string Err() const { return ReadText(scratch_ / "err"); }

 private:
  ScratchFolder scratch_;
  pid_t id_ = -1;
  int input_ = -1;
};

struct Outcome {
  int status = 0;
  std::string out, err;
};

/// Runs to the end with `input` as standard input.
Outcome Run(const std::string& program, const std::vector<std::string>& arguments,
            const std::string& input = "", const Child::Setup& setup = {});

}  // namespace strata::test
