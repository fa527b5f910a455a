// From the arguments to a checked batch or report. Nothing here touches a file.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "core/result.h"
#include "server/batch/model_options.h"
#include "server/batch/places.h"
#include "server/command_line.h"
#include "server/command_text.h"

namespace strata::server {

/// One of `count` shares of the models.
struct ModelShare {
  std::uint32_t index = 0, count = 1;
};

/// `strata batch REPO -o OUT`, every value within its range.
struct BatchCommand {
  std::string repository, output;
  std::optional<std::string> list;  ///< A file of paths; "-" is standard input.
  bool list_ends_with_nul = false;
  ModelFilter filter;
  OptionTexts options;  ///< Of the samples, from the command line.
  ModelShare share;
  std::uint32_t pictures = 60;
  std::uint32_t jobs = 1;
  std::uint64_t memory_bytes = 0;
  std::uint32_t timeout_seconds = 600;
  std::optional<std::string> scratch;
  std::optional<std::string>
      state;  ///< Of outputs in a bucket: the local folder; absent: the usual.
  std::uint64_t fetch_ahead_bytes = std::uint64_t{4} << 30;  ///< Of models from a bucket.
  bool s3_insecure = false;  ///< Plain http to a store on another machine, too.
  std::string simd = "auto";
  std::uint32_t progress_seconds = 10;
  bool force = false, prune = false, quiet = false;
};

/// The least --memory of a batch, bytes: its own, one worker's, and the least of one job.
inline constexpr std::uint64_t kLeastBatchMemory = std::uint64_t{192} << 20;

/// `strata report OUT...`.
struct ReportCommand {
  std::vector<std::string> outputs;
  bool json = false;
  std::optional<std::string> html;  ///< Where the page goes; absent: none.
  std::uint32_t slowest = 10;
  bool s3_insecure = false;  ///< As BatchCommand's.
};

/// The arguments after `batch` or `report`. Errors: kInvalidArgument, as ParseCommandLine.
Result<std::variant<BatchCommand, ShowText>> ParseBatch(std::span<const std::string> arguments);
Result<std::variant<ReportCommand, ShowText>> ParseReport(std::span<const std::string> arguments);

/// What their --help prints.
std::vector<CommandText> DescribeBatchCommands();

/// "-3-of-8" of a share, "" of the whole: in names of files.
std::string ShareSuffix(const ModelShare& share);

}  // namespace strata::server
