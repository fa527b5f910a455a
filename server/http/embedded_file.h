// Files of the source whose bytes the program carries. cmake/EmbedFiles.cmake writes the tables.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>

namespace strata::server {

struct EmbeddedFile {
  const char* path;  ///< Relative to its folder, after a "/".
  const unsigned char* bytes;
  std::size_t size;
  const char* etag;  ///< A strong entity tag, with its quotes: the SHA-256 of the bytes.

  std::string_view text() const { return {reinterpret_cast<const char*>(bytes), size}; }
};

using EmbeddedFiles = std::span<const EmbeddedFile>;

extern const EmbeddedFiles kOpenApiFiles;  ///< openapi.json alone.
extern const EmbeddedFiles kViewerFiles;   ///< server/viewer/dist.

}  // namespace strata::server
