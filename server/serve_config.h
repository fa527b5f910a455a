// From the arguments and strata.toml to a checked configuration of the service.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "core/result.h"
#include "server/batch/batch_service.h"
#include "server/command_line.h"
#include "server/http/exchange.h"
#include "server/http/tls.h"
#include "server/serve_option_table.h"
#include "server/service/log.h"
#include "server/service/service.h"
#include "server/store/store.h"

namespace strata::server {

/// Where a protocol listens.
struct Listen {
  std::string address;
  std::uint16_t port = 0;
};

/// Which command: `strata worker` runs jobs of a shared database, and answers no requests but those
/// for its health and figures.
enum class ServeMode : std::uint8_t { kServe, kWorker };

/// `strata serve` or `strata worker`, every value within its range.
struct ServeCommand {
  ServeMode mode = ServeMode::kServe;
  std::optional<Listen> http, grpc;  ///< Absent: off. Of serve at least one is there.
  TlsFiles tls;
  std::string keys;  ///< File; empty: none.
  std::vector<std::string> allowed_hosts;
  HttpLimits http_limits;
  ServiceLimits limits;
  std::optional<std::string> scratch;
  std::optional<StoreOptions> store;           ///< Absent: nothing is kept.
  std::optional<BatchServiceOptions> batches;  ///< Absent: no repository.
  LogFormat log_format = LogFormat::kText;
  LogLevel log_level = LogLevel::kInfo;
  std::uint32_t drain_seconds = 30;
};

/// The arguments after "serve". Reads the file of `--config`, or strata.toml in the working
/// directory if there is one; the command line goes before the file.
/// Errors: kInvalidArgument, naming option or file and line; kNotFound.
Result<std::variant<ServeCommand, ShowText>> ParseServe(std::span<const std::string> arguments,
                                                        ServeMode mode = ServeMode::kServe);

/// What `strata serve --help` and `strata worker --help` print.
CommandText DescribeServe(ServeMode mode = ServeMode::kServe);

struct ServeFile {
  ServeTexts texts;
  ServeTexts places;  ///< Of each name: "strata.toml, line 3: ".
};

/// The texts of a TOML file: `name = value`, no tables; lists where an option may be repeated.
/// Errors: kInvalidArgument, kNotFound.
Result<ServeFile> ReadServeFile(const std::string& path);

/// The checked configuration. Errors: kInvalidArgument.
Result<ServeCommand> CheckServe(const ServeTexts& texts, ServeMode mode = ServeMode::kServe);

}  // namespace strata::server
