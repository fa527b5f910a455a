#include "server/serve_config.h"

#include <toml++/toml.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <regex>
#include <sstream>
#include <thread>

#include "server/batch/batch_config.h"
#include "server/http/browser_guard.h"
#include "server/memory.h"
#include "server/nearest_name.h"
#include "server/parse_number.h"
#include "server/remote/s3_config.h"
#include "server/remote/s3_name.h"
#include "server/service/bucket_place.h"

namespace strata::server {
namespace {

tl::unexpected<Error> Invalid(std::string message) {
  return Fail(ErrorCode::kInvalidArgument, std::move(message));
}

std::vector<std::string> Names() {
  std::vector<std::string> names;
  for (const ServeOption& option : ServeOptions()) names.emplace_back(option.name);
  return names;
}

std::string HelpOf(const ServeOption& option) {
  const std::string standard = option.computed ? option.computed : option.standard;
  return option.help + std::string("\nDefault ") + (standard.empty() ? "none" : standard) + ".";
}

// --- Texts to values -----------------------------------------------------------------------------

/// Reads checked values out of the texts; keeps the first error.
class Reader {
 public:
  explicit Reader(const ServeTexts& texts) : texts_(texts) {}

  std::string Text(const std::string& name) const {
    const auto found = texts_.find(name);
    if (found != texts_.end()) return found->second;
    return std::ranges::find(ServeOptions(), name, &ServeOption::name)->standard;
  }
  bool Has(const std::string& name) const { return texts_.contains(name); }

  /// A whole number from `min` to `max`.
  std::uint64_t Number(const std::string& name, std::uint64_t min, std::uint64_t max) {
    const std::string option = "--" + name;
    const std::string expected =
        "a whole number from " + std::to_string(min) + " to " + std::to_string(max);
    return Take(
        ParseNumber<std::uint64_t>(Text(name), {option.c_str(), min, max, expected.c_str()}), min);
  }
  /// A size of at least `min` bytes.
  std::uint64_t Size(const std::string& name, std::uint64_t min,
                     std::uint64_t max = std::uint64_t{1} << 60) {
    const auto bytes = ParseSize(Text(name));
    if (bytes && *bytes >= min && *bytes <= max) return *bytes;
    Refuse("--" + name + ": found '" + Text(name) + "', expected a size from " +
           std::to_string(min) + " to " + std::to_string(max) + " bytes, such as 512M or 4G");
    return min;
  }
  /// Which of `names` it is.
  std::size_t OneOf(const std::string& name, const std::vector<std::string>& names) {
    const auto found = std::ranges::find(names, Text(name));
    if (found != names.end()) return static_cast<std::size_t>(found - names.begin());
    std::string all;
    for (const std::string& each : names) all += (all.empty() ? "" : " or ") + each;
    Refuse("--" + name + ": found '" + Text(name) + "', expected " + all);
    return 0;
  }
  /// "127.0.0.1:8080", "[::1]:8080" or "off".
  std::optional<Listen> Address(const std::string& name) {
    const std::string text = Text(name);
    if (text == "off") return std::nullopt;
    const std::size_t colon = text.rfind(':');
    Listen listen;
    if (colon != std::string::npos) {
      listen.address = text.substr(0, colon);
      if (listen.address.starts_with('[') && listen.address.ends_with(']')) {
        listen.address = listen.address.substr(1, listen.address.size() - 2);
      }
      const auto port = ParseNumber<std::uint16_t>(text.substr(colon + 1), {"", 0, 65535, ""});
      if (port && !listen.address.empty()) {
        listen.port = *port;
        return listen;
      }
    }
    Refuse("--" + name + ": found '" + text + "', expected ADDRESS:PORT or off");
    return std::nullopt;
  }
  /// The values of an option that may be repeated; each passes `check`.
  std::vector<std::string> Each(const std::string& name, bool (*check)(std::string_view),
                                const char* expected) {
    std::vector<std::string> values;
    std::istringstream text(Text(name));
    for (std::string value; std::getline(text, value, ',');) {
      if (!check(value)) Refuse("--" + name + ": found '" + value + "', expected " + expected);
      values.push_back(value);
    }
    return values;
  }
  void Refuse(std::string message) {
    if (outcome_) outcome_ = Invalid(std::move(message));
  }
  const Result<void>& outcome() const { return outcome_; }

 private:
  template <class T>
  T Take(const Result<T>& value, T otherwise) {
    if (value) return *value;
    if (outcome_) outcome_ = Forward(value);
    return otherwise;
  }

  const ServeTexts& texts_;
  Result<void> outcome_;
};

HttpLimits HttpLimitsOf(Reader& read) {
  HttpLimits limits;
  const auto number = [&read](const char* name, std::uint64_t min, std::uint64_t max) {
    return static_cast<std::uint32_t>(read.Number(name, min, max));
  };
  limits.connections = number("connections", 1, 100'000);
  limits.header_bytes = static_cast<std::uint32_t>(read.Size("header-size", 1 << 10, 1 << 20));
  limits.header_fields = number("header-fields", 1, 10'000);
  limits.header_seconds = number("header-timeout", 1, 3'600);
  limits.idle_seconds = number("idle-timeout", 1, 86'400);
  limits.bytes_per_second = number("min-rate", 1, 1'000'000'000);
  limits.grace_seconds = number("grace", 1, 3'600);
  return limits;
}

void ReadMemory(Reader& read, ServiceLimits& limits) {
  limits.jobs.memory_bytes = read.Has("memory") ? read.Size("memory", kLeastMemory)
                                                : std::max(kLeastMemory, UsableMemoryBytes() / 2);
  limits.job_memory_bytes =
      read.Has("job-memory") ? read.Size("job-memory", kLeastMemory)
                             : std::max(kLeastMemory, limits.jobs.memory_bytes / limits.jobs.jobs);
  if (limits.job_memory_bytes > limits.jobs.memory_bytes) {
    read.Refuse("--job-memory is more than --memory, which all jobs share");
  }
}

ServiceLimits ServiceLimitsOf(Reader& read) {
  const std::uint32_t processors = std::max(1u, std::thread::hardware_concurrency());
  const auto number = [&read](const char* name, std::uint64_t min, std::uint64_t max) {
    return static_cast<std::uint32_t>(read.Number(name, min, max));
  };
  ServiceLimits limits;
  limits.body_bytes = read.Size("body-size", 1);
  limits.requests = number("requests", 1, 10'000);
  limits.jobs.jobs = read.Has("jobs") ? number("jobs", 1, 1'024) : std::max(2u, processors);
  limits.jobs.waiting = number("queue", 0, 100'000);
  const std::uint32_t threads = number("job-threads", 0, 1'024);
  limits.job_threads = threads > 0 ? threads : processors;
  limits.job_seconds = number("job-time", 1, 1'000'000);
  limits.result_bytes = read.Size("result-size", 1);
  limits.isolate = read.OneOf("isolate", {"on", "off"}) == 0;
  ReadMemory(read, limits);
  return limits;
}

/// The first line of a file, without its end.
Result<std::string> ReadSecret(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  if (!file || !std::getline(file, line)) {
    return Invalid("--database-password-file " + path + ": cannot be read, or is empty");
  }
  if (line.ends_with('\r')) line.pop_back();
  return line;
}

void ReadDatabase(Reader& read, StoreOptions& options) {
  const std::string url = read.Text("database"), secret = read.Text("database-password-file");
  const std::uint64_t lease = read.Number("lease", 2, 3'600);
  if (read.Has("max-attempts")) {
    options.jobs.max_attempts = static_cast<std::int64_t>(read.Number("max-attempts", 1, 1'000));
  } else if (!url.empty()) {
    options.jobs.max_attempts = 3;
  }
  if (url.empty()) {
    if (!secret.empty()) read.Refuse("--database-password-file needs --database");
    return;
  }
  if (!url.starts_with("postgresql://") && !url.starts_with("postgres://")) {
    read.Refuse("--database: expected postgresql://[USER@]HOST[:PORT]/NAME");
  }
  options.shared.emplace();
  options.shared->postgres.url = url;
  options.shared->lease = options.jobs.lease = std::chrono::seconds(lease);
  if (secret.empty()) return;
  auto password = ReadSecret(secret);
  if (!password) return read.Refuse(password.error().message);
  options.shared->postgres.password = *std::move(password);
}

void ReadBucket(Reader& read, StoreOptions& options) {
  const std::string url = read.Text("blobs");
  options.blobs.cache_bytes = read.Size("blob-cache", 1);
  const bool insecure = read.OneOf("s3-insecure", {"off", "on"}) == 1;
  if (url.empty()) {
    if (read.Has("blob-cache")) read.Refuse("--blob-cache needs --blobs");
    if (read.Has("s3-insecure")) read.Refuse("--s3-insecure needs --blobs");
    return;
  }
  const auto prefix = ParseS3Folder(url);
  if (!prefix) return read.Refuse("--blobs: " + prefix.error().message);
  auto config = LoadS3Config(std::getenv, insecure);
  if (!config) return read.Refuse("--blobs: " + config.error().message);
  // Requests wait for it: of a store that is away they should be told soon.
  if (std::getenv("AWS_MAX_ATTEMPTS") == nullptr) config->max_attempts = 4;
  config->stall_seconds = 15;
  options.bucket = [prefix = *prefix, config = *std::move(config)](const std::string& data) {
    return OpenBucketPlace(prefix, config, data);
  };
}

std::optional<StoreOptions> StoreOptionsOf(Reader& read, const ServiceLimits& limits) {
  StoreOptions options;
  options.data = read.Text("data");
  options.models = read.Text("models");
  options.blobs.model_bytes = read.Size("model-disk", 1);
  options.blobs.result_bytes = read.Size("result-disk", 1);
  options.uploads.max_bytes = limits.body_bytes;
  options.jobs.max_queued = read.Number("stored-jobs", 1, 1'000'000);
  options.job_retention = std::chrono::hours(read.Number("keep-jobs", 1, 100'000));
  ReadDatabase(read, options);
  ReadBucket(read, options);
  if (!options.data.empty()) return options;
  if (options.shared) read.Refuse("--database needs --data, a folder that all its processes share");
  if (options.bucket) read.Refuse("--blobs needs --data, where drafts and copies lie");
  if (!options.models.empty()) read.Refuse("--models needs --data, where its hashes are kept");
  return std::nullopt;
}

/// What lets any process that shares the store go on with a batch.
void ShareBatches(const Reader& read, const StoreOptions& store, BatchServiceOptions& batches) {
  batches.lease = store.shared->lease;
  batches.most_attempts = store.jobs.max_attempts;
  if (!store.bucket) return;
  std::string url = read.Text("blobs");
  while (url.ends_with('/')) url.pop_back();
  batches.bucket = url + "/batches";
  batches.s3_insecure = read.Text("s3-insecure") == "on";
  const auto config = LoadS3Config(std::getenv, batches.s3_insecure);
  if (!config) return;  // ReadBucket has said so.
  batches.bucket_environment = {"AWS_ACCESS_KEY_ID=" + config->access_key,
                                "AWS_SECRET_ACCESS_KEY=" + config->secret_key};
  if (config->session_token.empty()) return;
  batches.bucket_environment.push_back("AWS_SESSION_TOKEN=" + config->session_token);
}

/// Over the repository, if there is one; a batch takes the part of one job, or the least that it
/// needs.
std::optional<BatchServiceOptions> BatchesOf(Reader& read, const ServiceLimits& limits) {
  BatchServiceOptions options;
  options.models = read.Text("models");
  options.folder = read.Has("batches") ? read.Text("batches") : read.Text("data") + "/batches";
  options.memory_bytes = std::max(limits.job_memory_bytes, kLeastBatchMemory);
  options.jobs = std::min(limits.job_threads, 1024u);
  options.timeout_seconds = limits.job_seconds;
  options.most_queued = read.Number("stored-jobs", 1, 1'000'000);
  options.retention = std::chrono::hours(read.Number("keep-jobs", 1, 100'000));
  if (options.models.empty()) {
    if (read.Has("batches")) read.Refuse("--batches needs --models, which they sample");
    return std::nullopt;
  }
  // A service that is too small for one has none.
  if (options.memory_bytes > limits.jobs.memory_bytes) {
    if (read.Has("batches")) read.Refuse("--batches needs --memory of 192M or more");
    return std::nullopt;
  }
  return options;
}

bool IsLoopback(const Listen& listen) {
  return listen.address == "::1" || listen.address.starts_with("127.");
}

void CheckAccess(const ServeCommand& command, Reader& read) {
  const bool insecure = read.OneOf("insecure", {"off", "on"}) == 1;
  if (!command.http && !command.grpc) read.Refuse("--http and --grpc are both off");
  if (command.tls.certificate.empty() != command.tls.key.empty()) {
    read.Refuse("--tls-certificate and --tls-key: give both or none");
  }
  if (!command.tls.client_ca.empty() && !command.tls.on()) {
    read.Refuse("--tls-client-ca needs --tls-certificate and --tls-key");
  }
  // A certificate of a client's is as good as a key.
  if (!command.keys.empty() || !command.tls.client_ca.empty() || insecure) return;
  for (const auto& listen : {command.http, command.grpc}) {
    if (!listen || IsLoopback(*listen)) continue;
    read.Refuse("listening on " + listen->address +
                " lets everybody who reaches it use the service: configure --keys or "
                "--tls-client-ca, or say --insecure");
  }
}

/// "--insecure" alone, as a flag is written, is "--insecure on".
std::vector<std::string> WithValues(std::span<const std::string> arguments) {
  std::vector<std::string> all;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    all.push_back(arguments[i]);
    const bool alone = i + 1 == arguments.size() || arguments[i + 1].starts_with("--");
    if (arguments[i] == "--insecure" && alone) all.emplace_back("on");
  }
  return all;
}

/// A message that may quote an address, as postgresql://user:password@host.
std::string WithoutPasswords(const std::string& message) {
  static const std::regex kPassword("(://[^:/@ ]*):[^ ]*@");
  return std::regex_replace(message, kPassword, "$1:...@");
}

/// Several values of an option as its one text.
std::string Joined(const std::vector<std::string>& values) {
  std::string all;
  for (const std::string& value : values) all += (all.empty() ? "" : ",") + value;
  return all;
}

std::string TextOf(const toml::node& node, bool repeated) {
  if (const auto* const list = node.as_array(); list && repeated) {
    std::vector<std::string> values;
    for (const toml::node& each : *list) {
      values.push_back(TextOf(each, false));
      if (values.back().empty()) return {};  // What is no text may not go missing.
    }
    return Joined(values);
  }
  if (const auto* const text = node.as_string()) return text->get();
  if (const auto* const truth = node.as_boolean()) return truth->get() ? "on" : "off";
  if (const auto* const whole = node.as_integer()) return std::to_string(whole->get());
  return {};
}

void AddOption(CLI::App& app, const ServeOption& option, ServeTexts& given) {
  const std::string flag = std::string("--") + option.name;
  const auto once = [&given, name = option.name](const std::string& text) { given[name] = text; };
  const auto each = [&given, name = option.name](const std::vector<std::string>& values) {
    given[name] = Joined(values);
  };
  CLI::Option* const added =
      option.repeated
          ? app.add_option_function<std::vector<std::string>>(flag, each, HelpOf(option))
                ->allow_extra_args(false)
          : app.add_option_function<std::string>(flag, once, HelpOf(option));
  added->option_text(option.value)->group(option.group);
}

std::unique_ptr<CLI::App> MakeServeApp(std::optional<std::string>& file, ServeTexts& given,
                                       ServeMode mode) {
  const bool worker = mode == ServeMode::kWorker;
  auto app = std::make_unique<CLI::App>(
      worker ? "Runs jobs of a database that several processes share."
             : "Serves sampling over HTTP and gRPC until SIGTERM or Ctrl-C.",
      worker ? "strata worker" : "strata serve");
  app->set_help_flag("-h,--help", "Print this and stop.");
  app->get_formatter()->column_width(27);
  app->add_option_function<std::string>(
         "--config", [&file](const std::string& text) { file = text; },
         "These options as TOML, `name = value`; the command line goes\nbefore it. Default "
         "strata.toml if there is one.")
      ->option_text("FILE");
  for (ServeOption option : ServeOptions()) {
    if (worker && !IsWorkerOption(option.name)) continue;
    if (worker && std::string_view(option.name) == "http") {
      option.help = "HTTP for /livez, /readyz and /metrics alone.";
      option.computed = "off";
    }
    AddOption(*app, option, given);
  }
  return app;
}

/// "--queue: found …" of a value that the file has: "strata.toml, line 3: queue: found …".
std::string InItsPlace(const std::string& message, const ServeTexts& places) {
  const std::size_t end = message.find_first_of(": ");
  if (!message.starts_with("--") || end == std::string::npos) return message;
  const auto place = places.find(message.substr(2, end - 2));
  return place == places.end() ? message : place->second + message.substr(2);
}

}  // namespace

CommandText DescribeServe(ServeMode mode) {
  std::optional<std::string> file;
  ServeTexts given;
  const std::string name = mode == ServeMode::kWorker ? "worker" : "serve";
  CommandText text = Describe(*MakeServeApp(file, given, mode), name);
  text.usage = "strata " + name + " [options]\n";
  return text;
}

Result<ServeFile> ReadServeFile(const std::string& path) {
  ServeFile file;
  if (std::error_code failed; !std::filesystem::exists(path, failed)) {
    return Fail(ErrorCode::kNotFound, path + ": no such file");
  }
  try {
    const toml::table table = toml::parse_file(path);
    for (const auto& [key, node] : table) {
      const std::string name(key.str());
      const std::string where = path + ", line " + std::to_string(node.source().begin.line) + ": ";
      const auto option = std::ranges::find(ServeOptions(), name, &ServeOption::name);
      if (option == ServeOptions().end()) {
        const std::string meant = NearestName(name, Names());
        return Invalid(where + "unknown option '" + name + "'" +
                       (meant.empty() ? "" : "; did you mean '" + meant + "'?"));
      }
      file.texts[name] = TextOf(node, option->repeated);
      file.places[name] = where;
      if (file.texts[name].empty()) {
        return Invalid(where + name + ": expected a text, whole number or truth");
      }
    }
  } catch (const toml::parse_error& error) {
    std::ostringstream message;
    message << path << ", line " << error.source().begin.line << ": " << error.description();
    return Invalid(message.str());
  }
  return file;
}

Result<ServeCommand> CheckServe(const ServeTexts& texts, ServeMode mode) {
  Reader read(texts);
  ServeCommand command;
  command.mode = mode;
  const bool worker = mode == ServeMode::kWorker;
  if (!worker || read.Has("http")) command.http = read.Address("http");
  if (!worker) command.grpc = read.Address("grpc");
  command.tls = {read.Text("tls-certificate"), read.Text("tls-key"), read.Text("tls-client-ca")};
  command.keys = read.Text("keys");
  command.allowed_hosts =
      read.Each("allowed-host", IsHostName, "a host's name or address, without a port");
  command.http_limits = HttpLimitsOf(read);
  command.limits = ServiceLimitsOf(read);
  command.store = StoreOptionsOf(read, command.limits);
  command.batches = BatchesOf(read, command.limits);
  if (command.batches && command.store && command.store->shared) {
    ShareBatches(read, *command.store, *command.batches);
  }
  if (read.Has("scratch")) command.scratch = read.Text("scratch");
  command.log_format = static_cast<LogFormat>(read.OneOf("log-format", {"text", "json"}));
  command.log_level =
      static_cast<LogLevel>(read.OneOf("log-level", {"debug", "info", "warning", "error"}));
  command.drain_seconds = static_cast<std::uint32_t>(read.Number("drain-timeout", 0, 86'400));
  if (!worker) CheckAccess(command, read);
  if (worker && !(command.store && command.store->shared)) {
    read.Refuse("strata worker needs --database and --data, where its jobs and models are");
  }
  if (!read.outcome()) return Forward(read.outcome());
  return command;
}

Result<std::variant<ServeCommand, ShowText>> ParseServe(std::span<const std::string> arguments,
                                                        ServeMode mode) {
  using Parsed = Result<std::variant<ServeCommand, ShowText>>;
  std::optional<std::string> file;
  ServeTexts given;
  const auto app = MakeServeApp(file, given, mode);
  std::vector<std::string> words = WithValues(arguments);
  std::ranges::reverse(words);  // CLI11 takes its vector back to front.
  try {
    app->parse(words);
  } catch (const CLI::CallForHelp&) {
    return Parsed(tl::in_place, std::in_place_type<ShowText>, ShowText{app->help()});
  } catch (const CLI::Error& error) {
    const char* const name = mode == ServeMode::kWorker ? "worker" : "serve";
    return Invalid(WithoutPasswords(error.what()) + "; see strata " + name + " --help");
  }
  constexpr const char* kUsual = "strata.toml";
  std::error_code failed;
  if (!file && std::filesystem::exists(kUsual, failed)) file = kUsual;
  ServeFile read;
  if (file) {
    auto texts = ReadServeFile(*file);
    if (!texts) return Forward(texts);
    read = *std::move(texts);
    for (const auto& [name, text] : given) read.places.erase(name);
    given.merge(read.texts);
  }
  auto command = CheckServe(given, mode);
  if (!command) return Invalid(InItsPlace(command.error().message, read.places));
  return Parsed(tl::in_place, std::in_place_type<ServeCommand>, *std::move(command));
}

}  // namespace strata::server
