#include "server/command_text.h"

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <sstream>
#include <utility>

namespace strata::server {
namespace {

OptionText Describe(const CLI::Option& option) {
  OptionText text;
  text.positional = option.get_positional();
  for (const std::string& name : option.get_snames()) text.names.push_back('-' + name);
  for (const std::string& name : option.get_lnames()) text.names.push_back("--" + name);
  if (text.positional) text.names = {option.get_name(true)};
  text.value = option.get_option_text();
  text.group = option.get_group();
  text.help = option.get_description();
  return text;
}

/// The lines of the help's "Usage: …", without that word.
std::string UsageOf(const CLI::App& app) {
  const auto formatter = std::dynamic_pointer_cast<CLI::Formatter>(app.get_formatter());
  std::istringstream printed(formatter ? formatter->make_usage(&app, app.get_name()) : "");
  std::string usage;
  for (std::string line; std::getline(printed, line);) {
    if (const auto at = line.find("strata"); at != line.npos) usage += line.substr(at) + '\n';
  }
  return usage;
}

}  // namespace

CommandText Describe(const CLI::App& app, std::string name) {
  CommandText text;
  text.name = std::move(name);
  text.summary = app.get_description();
  text.usage = UsageOf(app);
  for (const CLI::Option* option : app.get_options()) text.options.push_back(Describe(*option));
  text.footer = app.get_footer();
  return text;
}

std::vector<std::string> WordsOf(const OptionText& option) {
  if (option.value.find('|') == std::string::npos) return {};
  std::vector<std::string> words;
  std::istringstream text(option.value);
  for (std::string word; std::getline(text, word, '|');) words.push_back(word);
  return words;
}

}  // namespace strata::server
