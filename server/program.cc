#include "server/program.h"

#include <fcntl.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <exception>
#include <new>

#include "server/exit_codes.h"

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

/// Names of files and texts of foreign files stand in messages: their control characters, which a
/// terminal would obey, are shown. Line ends are the message's own.
std::string Shown(const std::string& message) {
  std::string text;
  for (std::size_t i = 0; i < message.size(); ++i) {
    const auto byte = static_cast<unsigned char>(message[i]);
    const auto next = static_cast<unsigned char>(i + 1 < message.size() ? message[i + 1] : 0);
    // U+0080 to U+009F, as UTF-8 has them, are control characters, too.
    const bool control = (byte < ' ' && byte != '\n') || byte == 0x7f ||
                         (byte == 0xc2 && next >= 0x80 && next < 0xa0);
    if (!control) {
      text += message[i];
      continue;
    }
    const unsigned char shown = byte == 0xc2 ? next : byte;
    std::array<char, 8> code;
    std::snprintf(code.data(), code.size(), "\\x%02x", shown);
    text += code.data();
    if (byte == 0xc2) ++i;
  }
  return text;
}

}  // namespace

bool IsServiceCommand(std::string_view name) {
  constexpr std::array kNames = {"serve", "worker", "key", "health", "batch", "report"};
  return std::ranges::find(kNames, name) != kNames.end();
}

int Report(const Error& error, int signal) {
  std::fprintf(stderr, "strata: %s\n", Shown(error.message).c_str());
  if (error.code == ErrorCode::kCancelled && signal != 0) return 128 + signal;
  return ExitCodeOf(error.code).exit_status;
}

int RunProgram(int argc, char** argv,
               const std::function<int(const std::vector<std::string>&)>& work) {
  OccupyStandardStreams();
  try {
    return work({argv + (argc > 0 ? 1 : 0), argv + argc});
  } catch (const std::bad_alloc&) {
    return Report({ErrorCode::kOverBudget, "out of memory"}, 0);
  } catch (const std::exception& error) {
    return Report({ErrorCode::kInternal, std::string("unexpected: ") + error.what()}, 0);
  }
}

}  // namespace strata::server
