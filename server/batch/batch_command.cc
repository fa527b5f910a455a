#include "server/batch/batch_command.h"

#include <cstdio>
#include <variant>

#include "server/batch/batch_config.h"
#include "server/batch/report.h"
#include "server/batch/run_batch.h"
#include "server/interrupt.h"

namespace strata::server {
namespace {

Result<int> Show(const ShowText& show) {
  if (std::fputs(show.text.c_str(), stdout) < 0 || std::fflush(stdout) != 0) {
    return Fail(ErrorCode::kIo, "cannot write to standard output");
  }
  return 0;
}

}  // namespace

Result<int> BatchMain(std::span<const std::string> arguments, int& signal) {
  const auto parsed = ParseBatch(arguments);
  if (!parsed) return Forward(parsed);
  if (const auto* const show = std::get_if<ShowText>(&*parsed)) return Show(*show);
  RunContext context;
  const InterruptGuard guard(context);
  const auto tally = RunBatch(std::get<BatchCommand>(*parsed), context);
  signal = guard.signal();
  if (!tally) return Forward(tally);
  return tally->all_failed() == 0 ? 0 : kSomeFailedStatus;
}

Result<int> ReportMain(std::span<const std::string> arguments) {
  const auto parsed = ParseReport(arguments);
  if (!parsed) return Forward(parsed);
  if (const auto* const show = std::get_if<ShowText>(&*parsed)) return Show(*show);
  if (auto done = RunReport(std::get<ReportCommand>(*parsed)); !done) return Forward(done);
  return 0;
}

}  // namespace strata::server
