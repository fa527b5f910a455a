// The program behind `strata serve`, `worker`, `key`, `health`, `batch` and `report`, and its own
// workers.
#include <span>
#include <string>
#include <vector>

#include "server/batch/batch_child.h"
#include "server/batch/batch_command.h"
#include "server/program.h"
#include "server/serve_command.h"
#include "server/service/worker.h"
#include "server/service/worker_process.h"
#include "server/service_tools.h"

namespace strata::server {
namespace {

int RunBatchCommand(std::span<const std::string> arguments) {
  int signal = 0;
  const auto status = BatchMain(arguments, signal);
  return status ? *status : Report(status.error(), signal);
}

int Main(const std::vector<std::string>& arguments) {
  if (arguments.size() == 1 && arguments[0] == kWorkerCommand) return RunWorker();
  if (arguments.size() > 1 && arguments[0] == kBatchChildCommand) {
    if (!EnterBatchChild(arguments[1])) return 1;
    return RunBatchCommand(std::span(arguments).subspan(2));
  }
  if (arguments.empty() || !IsServiceCommand(arguments[0])) {
    return Report({ErrorCode::kInvalidArgument, "strata-serve is started by `strata serve`"}, 0);
  }
  const std::span rest = std::span(arguments).subspan(1);
  if (arguments[0] == "batch") return RunBatchCommand(rest);
  if (arguments[0] == "report") {
    const auto status = ReportMain(rest);
    return status ? *status : Report(status.error(), 0);
  }
  const auto run = arguments[0] == "serve"    ? RunServe
                   : arguments[0] == "worker" ? RunWorkerNode
                   : arguments[0] == "key"    ? RunKey
                                              : RunHealth;
  const Result<void> outcome = run(rest);
  return outcome ? 0 : Report(outcome.error(), 0);
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  return strata::server::RunProgram(argc, argv, strata::server::Main);
}
