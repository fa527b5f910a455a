#include "server/pages/man_page.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdint>
#include <cstdio>
#include <sstream>
#include <string_view>
#include <vector>

#include "server/exit_codes.h"

namespace strata::server {
namespace {

/// The character that begins at `at`, beyond ASCII, by its number, as roff takes it whatever
/// encoding it reads; moves `at` to its last byte. The help's texts are UTF-8.
std::string ByNumber(std::string_view text, std::size_t& at) {
  const auto first = static_cast<unsigned char>(text[at]);
  const int more = first >= 0xF0 ? 3 : first >= 0xE0 ? 2 : 1;
  std::uint32_t number = first & (0x3Fu >> more);
  for (int i = 0; i < more && at + 1 < text.size(); ++i) {
    number = number << 6 | (static_cast<unsigned char>(text[++at]) & 0x3F);
  }
  std::array<char, 16> name;
  std::snprintf(name.data(), name.size(), "\\[u%04X]", static_cast<unsigned>(number));
  return name.data();
}

/// Text as roff prints it unchanged. What stands between backquotes becomes bold.
std::string Escaped(std::string_view text) {
  std::string out;
  bool bold = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    switch (c) {
      case '\\':
        out += "\\e";
        break;
      case '-':
        out += "\\-";
        break;
      case '\'':
        out += "\\(aq";
        break;
      case '^':
        out += "\\(ha";
        break;
      case '~':
        out += "\\(ti";
        break;
      case '"':
        out += "\\(dq";
        break;
      case '`':
        bold = !bold;
        out += bold ? "\\fB" : "\\fR";
        break;
      default:
        out += static_cast<unsigned char>(c) < 0x80 ? std::string(1, c) : ByNumber(text, i);
    }
  }
  // A dot at the beginning would be a request.
  return out.starts_with('.') ? "\\&" + out : out;
}

std::vector<std::string> Lines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

/// Lines that roff fills into a paragraph.
std::string Filled(const std::string& text) {
  std::string out;
  for (const std::string& line : Lines(text)) out += Escaped(line) + '\n';
  return out;
}

/// "a, b and c" as the first line of an entry: names bold, the value in italics.
std::string Tag(const OptionText& option) {
  std::string out;
  for (const std::string& name : option.names) {
    if (!out.empty()) out += ", ";
    out += option.positional ? "\\fI" + Escaped(name) + "\\fR" : "\\fB" + Escaped(name) + "\\fR";
  }
  return option.value.empty() ? out : out + " \\fI" + Escaped(option.value) + "\\fR";
}

std::string Entry(const std::string& tag, const std::string& text) {
  return ".TP\n" + tag + '\n' + Filled(text);
}

/// Options under the headings of the help, in its order.
std::string Options(const CommandText& command) {
  std::vector<std::string> groups;
  for (const OptionText& option : command.options) {
    if (std::ranges::find(groups, option.group) == groups.end()) groups.push_back(option.group);
  }
  std::string out = ".SH OPTIONS\n";
  for (const std::string& group : groups) {
    if (group != "Options") out += ".SS " + Escaped(group) + '\n';
    for (const OptionText& option : command.options) {
      if (option.group == group) out += Entry(Tag(option), option.help);
    }
  }
  return out;
}

/// The lines of a block as they are.
std::string Verbatim(const std::vector<std::string>& lines) {
  std::string out = ".nf\n";
  for (const std::string& line : lines) out += Escaped(line) + '\n';
  return out + ".fi\n";
}

struct Footer {
  std::string examples, prose;
};

/// The footer's blocks, without the exit codes: those come from their table.
Footer FooterOf(const CommandText& command) {
  Footer footer;
  std::vector<std::string> block;
  const auto flush = [&] {
    const std::string heading = block.empty() ? "Exit codes:" : block.front();
    if (heading == "Examples:") {
      footer.examples = ".SH EXAMPLES\n" + Verbatim({block.begin() + 1, block.end()});
    } else if (heading != "Exit codes:") {
      footer.prose += ".PP\n";
      for (const std::string& line : block) footer.prose += Escaped(line) + '\n';
    }
    block.clear();
  };
  for (const std::string& line : Lines(command.footer)) {
    if (line.empty()) flush();
    if (!line.empty()) block.push_back(line);
  }
  flush();
  return footer;
}

std::string ExitStatus() {
  std::string out = ".SH \"EXIT STATUS\"\n" + Entry("0", "done");
  for (const ExitCode& row : kExitCodes) out += Entry(std::to_string(row.exit_status), row.meaning);
  return out;
}

std::string Commands(std::span<const CommandText> all) {
  std::string out = ".SH COMMANDS\n";
  for (const CommandText& each : all) {
    if (each.name.empty()) continue;
    out += Entry("\\fBstrata " + Escaped(each.name) + "\\fR", each.summary);
  }
  return out;
}

std::string SeeAlso(const CommandText& command, std::span<const CommandText> all) {
  std::string names;
  for (const CommandText& each : all) {
    if (each.name == command.name) continue;
    if (!names.empty()) names += ",\n";
    names += ".BR " + Escaped(PageName(each)) + " (1)";
  }
  // The comma belongs to the request's line.
  for (auto at = names.find("(1),\n"); at != names.npos; at = names.find("(1),\n", at + 1)) {
    names.replace(at, 4, "(1),");
  }
  return ".SH \"SEE ALSO\"\n" + names + '\n';
}

/// "Sample a mesh file." as the line under NAME has it: "sample a mesh file".
std::string Brief(std::string summary) {
  if (summary.ends_with('.')) summary.pop_back();
  if (summary.starts_with("Strata ")) summary.erase(0, 7);
  if (!summary.empty()) {
    summary[0] = static_cast<char>(std::tolower(static_cast<unsigned char>(summary[0])));
  }
  return summary;
}

}  // namespace

std::string PageName(const CommandText& command) {
  return command.name.empty() ? "strata" : "strata-" + command.name;
}

std::string ManPage(const CommandText& command, std::span<const CommandText> all,
                    const PageEdge& edge) {
  std::string title = PageName(command);
  std::ranges::transform(title, title.begin(), [](unsigned char c) { return std::toupper(c); });
  std::string out = ".TH " + Escaped(title) + " 1 \"" + edge.date + "\" \"Strata " + edge.version +
                    "\" \"User Commands\"\n.SH NAME\n" + Escaped(PageName(command)) + " \\- " +
                    Escaped(Brief(command.summary)) + "\n.SH SYNOPSIS\n.nf\n";
  for (const std::string& line : Lines(command.usage)) out += ".B " + Escaped(line) + '\n';
  out += ".fi\n.SH DESCRIPTION\n" + Filled(command.summary);
  const Footer footer = FooterOf(command);
  out += footer.prose;
  if (command.name.empty()) out += Commands(all);
  return out + Options(command) + ExitStatus() + footer.examples + SeeAlso(command, all);
}

}  // namespace strata::server
