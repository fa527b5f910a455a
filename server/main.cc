// The command `strata`.
#include <fcntl.h>

#include <cstdio>
#include <exception>
#include <new>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "server/command_line.h"
#include "server/exit_codes.h"
#include "server/info_command.h"
#include "server/interrupt.h"
#include "server/memory.h"
#include "server/sample_command.h"
#ifdef STRATA_SERVICE
#include "server/serve_command.h"
#include "server/service/job_process.h"
#include "server/service/worker.h"
#endif

namespace strata::server {
namespace {

/// Gives a standard stream that was closed at the start a descriptor that every use fails on. Left
/// closed, its number would go to the next file that is opened: bytes meant for standard output
/// would end up there, and standard input would be read from it.
void OccupyStandardStreams() {
  for (const int stream : {0, 1, 2}) {
    if (fcntl(stream, F_GETFD) >= 0) continue;
    // Those below are open, so that this takes the number itself.
    if (open("/dev/null", stream == 0 ? O_WRONLY : O_RDONLY) < 0) return;
  }
}

int Report(const Error& error, int signal) {
  std::fprintf(stderr, "strata: %s\n", error.message.c_str());
  if (error.code == ErrorCode::kCancelled && signal != 0) return 128 + signal;
  return ExitCodeOf(error.code).exit_status;
}

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

#ifdef STRATA_SERVICE
/// The commands of the service, which have a grammar of their own. Nothing: it is none of them.
std::optional<int> RunServiceCommand(const std::vector<std::string>& arguments) {
  if (arguments.empty()) return std::nullopt;
  const std::span rest = std::span(arguments).subspan(1);
  if (arguments[0] == kWorkerCommand && rest.empty()) return RunWorker();
  Result<void> outcome;
  if (arguments[0] == "serve") {
    outcome = RunServe(rest);
  } else if (arguments[0] == "key") {
    outcome = RunKey(rest);
  } else {
    return std::nullopt;
  }
  return outcome ? 0 : Report(outcome.error(), 0);
}
#endif

int Main(const std::vector<std::string>& arguments) {
  try {
#ifdef STRATA_SERVICE
    if (const auto status = RunServiceCommand(arguments)) return *status;
#endif
    const auto command = ParseCommandLine(arguments);
    return command ? std::visit(Runner{}, *command) : Report(command.error(), 0);
  } catch (const std::bad_alloc&) {
    return Report({ErrorCode::kOverBudget, "out of memory"}, 0);
  } catch (const std::exception& error) {
    return Report({ErrorCode::kInternal, std::string("unexpected: ") + error.what()}, 0);
  }
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  strata::server::OccupyStandardStreams();
  return strata::server::Main({argv + (argc > 0 ? 1 : 0), argv + argc});
}
