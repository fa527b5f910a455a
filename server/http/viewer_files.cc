#include "server/http/viewer_files.h"

#include <algorithm>
#include <array>
#include <string>
#include <string_view>

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

/// Whether an If-None-Match header has this tag (RFC 9110, 13.1.2: weak tags are equal to strong).
bool Matches(std::string_view header, std::string_view etag) {
  return header == "*" || header.find(etag) != std::string_view::npos;
}

}  // namespace

void RespondViewerFile(Exchange& exchange) {
  const std::string& asked = exchange.target().path;
  const std::string_view path = asked == "/" ? "/index.html" : std::string_view(asked);
  const auto file = std::ranges::find(kViewerFiles, path, &EmbeddedFile::path);
  if (file == kViewerFiles.end()) {
    return exchange.RespondProblem(ProblemOf(Refusal::kNoSuchPath, "found " + asked));
  }
  // The names stay when the contents change, so every use asks whether they did.
  const Headers validity = {{"ETag", file->etag}, {"Cache-Control", "no-cache"}};
  if (Matches(exchange.header("If-None-Match"), file->etag)) {
    return exchange.Respond(304, validity, "");
  }
  Headers headers = validity;
  headers.insert(headers.end(), {{"Content-Type", MediaTypeOfFile(path)},
                                 {"Content-Security-Policy", kPolicy},
                                 {"Referrer-Policy", "no-referrer"},
                                 {"Cross-Origin-Opener-Policy", "same-origin"}});
  exchange.Respond(200, headers, file->text());
}

}  // namespace strata::server
