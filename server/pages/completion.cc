#include "server/pages/completion.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <vector>

namespace strata::server {
namespace {

/// What a shell shows beside an option: the help's first sentence, on one line.
std::string Brief(const std::string& help) {
  std::string text = help;
  std::ranges::replace(text, '\n', ' ');
  return text.substr(0, text.find(". ") == text.npos ? text.find_last_of('.') : text.find(". "));
}

std::string Joined(const std::vector<std::string>& words, const char* between) {
  std::string all;
  for (const std::string& word : words) all += (all.empty() ? "" : between) + word;
  return all;
}

std::string WithBackslashes(const std::string& text, std::string_view before) {
  std::string out;
  for (const char c : text) {
    if (before.find(c) != before.npos) out += '\\';
    out += c;
  }
  return out;
}

/// Between single quotes in sh and zsh, where a quote is left and come back to.
std::string InQuotes(const std::string& text) {
  std::string out;
  for (const char c : text) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
  return out;
}

std::vector<std::string> OptionNames(const CommandText& command) {
  std::vector<std::string> names;
  for (const OptionText& option : command.options) {
    if (!option.positional) names.insert(names.end(), option.names.begin(), option.names.end());
  }
  return names;
}

std::vector<std::string> CommandNames(std::span<const CommandText> all) {
  std::vector<std::string> names;
  for (const CommandText& each : all) {
    if (!each.name.empty()) names.push_back(each.name);
  }
  return names;
}

/// What the first positional of a command is, if there is one.
ValueKind PositionalKind(const CommandText& command) {
  const auto first = std::ranges::find_if(command.options, &OptionText::positional);
  return first == command.options.end() ? ValueKind::kNone : KindOf(*first);
}

/// The branches of one command in bash: what follows an option, then what may begin a word.
std::string BashCommand(const CommandText& command) {
  std::string out = "    " + command.name + ")\n      case $prev in\n";
  for (const OptionText& option : command.options) {
    if (option.positional || KindOf(option) == ValueKind::kNone) continue;
    out += "        " + Joined(option.names, "|") + ") ";
    switch (KindOf(option)) {
      case ValueKind::kWords:
        out += "words='" + Joined(WordsOf(option), " ") + "'";
        break;
      case ValueKind::kFile:
        out += "paths=-f";
        break;
      case ValueKind::kFolder:
        out += "paths=-d";
        break;
      default:
        out += "return";
    }
    out += " ;;\n";
  }
  const bool files = PositionalKind(command) == ValueKind::kFile;
  return out + "        *) options='" + Joined(OptionNames(command), " ") + "'" +
         (files ? " paths=-f" : "") + " ;;\n      esac ;;\n";
}

std::string ZshValue(const OptionText& option) {
  const std::string name =
      WithBackslashes(option.value.empty() ? option.names[0] : option.value, ":[]");
  switch (KindOf(option)) {
    case ValueKind::kNone:
      return "";
    case ValueKind::kWords:
      return ":" + name + ":(" + Joined(WordsOf(option), " ") + ")";
    case ValueKind::kFile:
      return ":" + name + ":_files";
    case ValueKind::kFolder:
      return ":" + name + ":_files -/";
    case ValueKind::kOther:
      return ":" + name + ": ";
  }
  return "";
}

std::string ZshOption(const OptionText& option) {
  const std::string value = ZshValue(option);
  if (option.positional) return " '*" + InQuotes(value) + "'";
  const std::string text =
      "'[" + InQuotes(WithBackslashes(Brief(option.help), ":[]\\")) + "]" + InQuotes(value) + "'";
  const std::string names = Joined(option.names, ",");
  const bool one = option.names.size() == 1;
  return one ? " " + names + text : " '(" + Joined(option.names, " ") + ")'{" + names + "}" + text;
}

std::string FishOption(const CommandText& command, const OptionText& option) {
  std::string out = "complete -c strata -n '__fish_";
  out += command.name.empty() ? "use_subcommand'" : "seen_subcommand_from " + command.name + "'";
  for (const std::string& name : option.names) {
    out += name.starts_with("--") ? " -l " + name.substr(2) : " -s " + name.substr(1);
  }
  switch (KindOf(option)) {
    case ValueKind::kNone:
      break;
    case ValueKind::kWords:
      out += " -x -a '" + Joined(WordsOf(option), " ") + "'";
      break;
    case ValueKind::kFile:
      out += " -r -F";
      break;
    case ValueKind::kFolder:
      out += " -x -a '(__fish_complete_directories)'";
      break;
    case ValueKind::kOther:
      out += " -x";
      break;
  }
  return out + " -d '" + WithBackslashes(Brief(option.help), "'\\") + "'\n";
}

constexpr const char* kBashHead =
    R"(# Completion of strata(1) for bash. Made from what --help prints.
_strata() {
  local cur=${COMP_WORDS[COMP_CWORD]} prev=${COMP_WORDS[COMP_CWORD-1]} command='' i
  # "--name=value" comes as three words.
  if [[ $cur == = ]]; then
    cur=''
  elif [[ $prev == = ]]; then
    prev=${COMP_WORDS[COMP_CWORD-2]}
  fi
  for ((i = 1; i < COMP_CWORD; ++i)); do
    if [[ ${COMP_WORDS[i]} != -* ]]; then
      command=${COMP_WORDS[i]}
      break
    fi
  done
  local words='' options='' paths=''
  case $command in
)";

constexpr const char* kBashTail = R"(  esac
  COMPREPLY=()
  if [[ $cur == -* && -n $options ]]; then
    words=$options paths=''
  fi
  if [[ -n $words ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$words" -- "$cur")
  elif [[ -n $paths ]]; then
    compopt -o filenames 2>/dev/null
    mapfile -t COMPREPLY < <(compgen "$paths" -- "$cur")
  fi
}
complete -F _strata strata
)";

}  // namespace

ValueKind KindOf(const OptionText& option) {
  constexpr std::array<std::string_view, 7> kPaths = {"INPUT", "OUTPUT", "MESH", "PART",
                                                      "REPO",  "OUT",    "PATH"};
  const std::string& name = option.positional ? option.names[0] : option.value;
  if (name.empty()) return ValueKind::kNone;
  if (!WordsOf(option).empty()) return ValueKind::kWords;
  if (name == "DIR") return ValueKind::kFolder;
  const bool path = name.starts_with("FILE") || std::ranges::find(kPaths, name) != kPaths.end();
  return path ? ValueKind::kFile : ValueKind::kOther;
}

std::string BashCompletion(std::span<const CommandText> all) {
  std::string out = kBashHead;
  for (const CommandText& each : all) {
    if (!each.name.empty()) out += BashCommand(each);
    if (each.name.empty()) {
      out += "    '') words='" + Joined(CommandNames(all), " ") + ' ' +
             Joined(OptionNames(each), " ") + "' ;;\n";
    }
  }
  return out + kBashTail;
}

std::string ZshCompletion(std::span<const CommandText> all) {
  std::string out =
      "#compdef strata\n# Made from what --help prints.\n_strata() {\n  local -a commands=(\n";
  for (const CommandText& each : all) {
    if (each.name.empty()) continue;
    out += "    '" + each.name + ":" + InQuotes(WithBackslashes(Brief(each.summary), ":")) + "'\n";
  }
  out += "  )\n  if (( CURRENT == 2 )); then\n    _describe -t commands command commands\n";
  for (const CommandText& each : all) {
    if (!each.name.empty()) continue;
    out += "    _arguments";
    for (const OptionText& option : each.options) out += " \\\n     " + ZshOption(option);
  }
  out +=
      "\n    return\n  fi\n  local command=$words[2]\n  shift words\n  (( CURRENT-- ))\n  case "
      "$command in\n";
  for (const CommandText& each : all) {
    if (each.name.empty()) continue;
    out += "    " + each.name + ") _arguments -s";
    for (const OptionText& option : each.options) out += " \\\n     " + ZshOption(option);
    out += " ;;\n";
  }
  return out + "  esac\n}\n_strata \"$@\"\n";
}

std::string FishCompletion(std::span<const CommandText> all) {
  std::string out = "# Completion of strata(1) for fish. Made from what --help prints.\n";
  for (const CommandText& each : all) {
    if (!each.name.empty()) {
      out += "complete -c strata -n __fish_use_subcommand -f -a " + each.name + " -d '" +
             WithBackslashes(Brief(each.summary), "'\\") + "'\n";
    }
    const bool files = PositionalKind(each) == ValueKind::kFile;
    if (!each.name.empty() && !files) {
      out += "complete -c strata -n '__fish_seen_subcommand_from " + each.name + "' -f\n";
    }
    for (const OptionText& option : each.options) {
      if (!option.positional) out += FishOption(each, option);
    }
  }
  return out;
}

}  // namespace strata::server
