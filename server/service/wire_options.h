// From the wire's options to a checked command: the same check as the command line's.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/result.h"
#include "server/command_line.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// Every option within its range, in the command that does it, quietly, from `input` to `output`
/// (paths). Errors: kInvalidArgument; the message names the field, what was found, the range and
/// the default.
Result<SampleCommand> CommandOf(const v1::SampleOptions& options, const std::string& input,
                                const std::string& output);

/// Options from texts, as a URL's query has them: the names are the fields of v1::SampleOptions,
/// `-` in a name is as good as `_`. What is found is checked like CommandOf.
/// Errors: kInvalidArgument: unknown or repeated name, or a value that the check refuses.
Result<v1::SampleOptions> OptionsFromTexts(
    const std::vector<std::pair<std::string, std::string>>& texts);

/// "drc" → "model/vnd.draco" and so on. Precondition: a name that CommandOf accepts.
const char* MediaTypeOf(io::SampleFormat format);
/// Of a drc of more samples than a tile: the folder of tiles as one body.
inline constexpr const char* kZipMediaType = "application/zip";

/// The names and media types of all formats, in the order in which the server prefers them.
struct FormatName {
  io::SampleFormat format;
  const char* name;
  const char* media_type;
};
std::span<const FormatName> Formats();

}  // namespace strata::server
