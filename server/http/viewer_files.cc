#include "server/http/viewer_files.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "server/http/conditional.h"
#include "server/http/embedded_file.h"

namespace strata::server {
namespace {

struct MediaType {
  std::string_view suffix;
  const char* name;
};

constexpr std::array<MediaType, 6> kMediaTypes = {{
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".svg", "image/svg+xml"},
    {".wasm", "application/wasm"},
    {".txt", "text/plain; charset=utf-8"},
}};

const char* MediaTypeOfFile(std::string_view path) {
  const auto found = std::ranges::find_if(
      kMediaTypes, [&](const MediaType& type) { return path.ends_with(type.suffix); });
  return found == kMediaTypes.end() ? "application/octet-stream" : found->name;
}

/// The page loads from this server alone and nothing may frame it. Draco's decoder is WebAssembly,
/// which 'wasm-unsafe-eval' allows without allowing eval.
constexpr const char* kPolicy =
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'";

Content ContentOf(const EmbeddedFile& file) {
  Content content;
  content.read = [text = file.text()](std::uint64_t offset, std::span<char> out) -> Result<void> {
    text.copy(out.data(), out.size(), offset);
    return {};
  };
  content.size = file.size;
  content.media_type = MediaTypeOfFile(file.path);
  content.etag = file.etag;
  return content;
}

}  // namespace

void RespondViewerFile(Exchange& exchange) {
  const std::string& asked = exchange.target().path;
  const std::string_view path = asked == "/" ? "/index.html" : std::string_view(asked);
  const auto file = std::ranges::find(kViewerFiles, path, &EmbeddedFile::path);
  if (file == kViewerFiles.end()) {
    return exchange.RespondProblem(ProblemOf(Refusal::kNoSuchPath, "found " + asked));
  }
  RespondConditional(exchange, ContentOf(*file),
                     {{"Cache-Control", "no-cache"},  // Names stay when contents change: ask.
                      {"Content-Security-Policy", kPolicy},
                      {"Referrer-Policy", "no-referrer"},
                      {"Cross-Origin-Opener-Policy", "same-origin"}});
}

}  // namespace strata::server
