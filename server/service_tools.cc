#include "server/service_tools.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <optional>

#include "server/http/health_probe.h"
#include "server/parse_number.h"
#include "server/service/api_keys.h"

namespace strata::server {
namespace {

/// The usage is of the house's form; the rest of the help is CLI11's.
class ToolFormatter : public CLI::Formatter {
 public:
  explicit ToolFormatter(std::string usage) : usage_(std::move(usage)) { column_width(27); }
  std::string make_usage(const CLI::App*, std::string) const override {
    return "\nUsage: " + usage_ + "\n";
  }

 private:
  std::string usage_;
};

std::unique_ptr<CLI::App> MakeTool(const char* summary, const char* usage) {
  auto app = std::make_unique<CLI::App>(summary, "strata");
  app->formatter(std::make_shared<ToolFormatter>(usage));
  app->set_help_flag("-h,--help", "Print this and stop.");
  return app;
}

CLI::Option* Add(CLI::App& app, const char* name, std::string& into, const char* value,
                 const char* help) {
  return app.add_option(name, into, help)->option_text(value)->type_name(value);
}

struct KeyTexts {
  std::string name, role = "full";
};

std::unique_ptr<CLI::App> MakeKeyApp(KeyTexts& texts) {
  auto app = MakeTool("Makes an API key and the line that lets it in.",
                      "strata key NAME [--role full|read]");
  Add(*app, "NAME", texts.name, "",
      "Whose key it is, for logs and figures: 1 to 64 letters, digits,\n- _ . @. Required.");
  Add(*app, "--role", texts.role, "full|read",
      "full may do everything, read what changes nothing. Default full.");
  app->footer(
      "The key goes to standard error, once; the line, which holds only its\n"
      "SHA-256, to standard output: add it to the file of `strata serve --keys`.\n");
  return app;
}

struct HealthTexts {
  std::string url = "http://127.0.0.1:8080/livez", timeout = "5";
};

std::unique_ptr<CLI::App> MakeHealthApp(HealthTexts& texts) {
  auto app =
      MakeTool("Asks a service whether it lives.", "strata health [URL] [--timeout SECONDS]");
  Add(*app, "URL", texts.url, "",
      "http or https; the path /livez or /readyz. A certificate is not\n"
      "checked. Default http://127.0.0.1:8080/livez.");
  Add(*app, "--timeout", texts.timeout, "SECONDS", "1 to 3600. Default 5.");
  app->footer(
      "Exit status 0 and no output where the answer is 200; else 8, and what\n"
      "came instead on standard error.\n");
  return app;
}

/// True when the arguments were taken, false when their help was printed.
Result<bool> Parse(CLI::App& app, std::span<const std::string> arguments) {
  try {
    // CLI11 takes its vector back to front.
    app.parse(std::vector<std::string>(arguments.rbegin(), arguments.rend()));
  } catch (const CLI::CallForHelp&) {
    std::fputs(app.help().c_str(), stdout);
    return false;
  } catch (const CLI::Error& error) {
    return Fail(ErrorCode::kInvalidArgument, error.what());
  }
  return true;
}

}  // namespace

Result<void> RunKey(std::span<const std::string> arguments) {
  KeyTexts texts;
  const auto parsed = Parse(*MakeKeyApp(texts), arguments);
  if (!parsed) return Forward(parsed);
  if (!*parsed) return {};
  if (texts.role != "full" && texts.role != "read") {
    return Fail(ErrorCode::kInvalidArgument,
                "--role: found '" + texts.role + "', expected full or read");
  }
  const auto made = MakeKey(texts.name, texts.role == "full" ? Role::kFull : Role::kRead);
  if (!made) return Forward(made);
  std::fprintf(stderr, "The key, shown this once: %s\n", made->key.c_str());
  if (std::printf("%s\n", made->line.c_str()) < 0 || std::fflush(stdout) != 0) {
    return Fail(ErrorCode::kIo, "cannot write to standard output");
  }
  return {};
}

Result<void> RunHealth(std::span<const std::string> arguments) {
  HealthTexts texts;
  const auto parsed = Parse(*MakeHealthApp(texts), arguments);
  if (!parsed) return Forward(parsed);
  if (!*parsed) return {};
  const auto url = ParseHealthUrl(texts.url);
  if (!url) return Forward(url);
  const auto seconds = ParseNumber<std::uint32_t>(
      texts.timeout, {"--timeout", 1, 3'600, "a whole number from 1 to 3600 (default 5)"});
  if (!seconds) return Forward(seconds);
  return ProbeHealth(*url, std::chrono::seconds(*seconds));
}

std::vector<CommandText> DescribeServiceTools() {
  KeyTexts key;
  HealthTexts health;
  return {Describe(*MakeKeyApp(key), "key"), Describe(*MakeHealthApp(health), "health")};
}

}  // namespace strata::server
