// The command `strata`.
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <string>
#include <system_error>
#include <variant>
#include <vector>

#include "server/command_line.h"
#include "server/info_command.h"
#include "server/interrupt.h"
#include "server/memory.h"
#include "server/program.h"
#include "server/sample_command.h"

namespace strata::server {
namespace {

template <class Work>
int RunGuarded(std::uint64_t memory, Work work) {
  RunContext context(memory);
  const InterruptGuard guard(context);
  const Result<void> outcome = work(context);
  return outcome ? 0 : Report(outcome.error(), guard.signal());
}

std::uint64_t BudgetOf(const SampleCommand& command) {
  return command.memory.value_or(UsableMemoryBytes() / 2);
}

struct Runner {
  int operator()(const SampleCommand& command) const {
    return RunGuarded(BudgetOf(command),
                      [&](RunContext& context) { return RunSample(command, context); });
  }
  int operator()(const ScanCommand& command) const {
    return RunGuarded(BudgetOf(command.job),
                      [&](RunContext& context) { return RunScan(command, context); });
  }
  int operator()(const MergeCommand& command) const {
    return RunGuarded(BudgetOf(command.job),
                      [&](RunContext& context) { return RunMerge(command, context); });
  }
  int operator()(const InfoCommand& command) const {
    return RunGuarded(UsableMemoryBytes() / 2,
                      [&](RunContext& context) { return RunInfo(command, context); });
  }
  int operator()(const ShowText& show) const {
    const bool good = std::fputs(show.text.c_str(), stdout) >= 0 && std::fflush(stdout) == 0;
    return good ? 0 : Report({ErrorCode::kIo, "cannot write to standard output"}, 0);
  }
};

/// The service is a program of its own beside this one: its libraries take longer to load than a
/// small mesh takes to be sampled. Returns only if it cannot be started.
int BecomeService(char** argv) {
  std::error_code failed;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", failed);
  const std::string program = (self.parent_path() / "strata-serve").string();
  execv(program.c_str(), argv);
  const std::string reason = std::generic_category().message(errno);
  return Report({ErrorCode::kNotFound, program + ": cannot start the service: " + reason}, 0);
}

int Main(const std::vector<std::string>& arguments, char** argv) {
  if (!arguments.empty() && IsServiceCommand(arguments[0])) return BecomeService(argv);
  const auto command = ParseCommandLine(arguments);
  return command ? std::visit(Runner{}, *command) : Report(command.error(), 0);
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  return strata::server::RunProgram(argc, argv, [&](const std::vector<std::string>& arguments) {
    return strata::server::Main(arguments, argv);
  });
}
