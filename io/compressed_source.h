// Unpacking gzip and zstd on the fly.
#pragma once

#include <memory>

#include "core/result.h"
#include "io/byte_source.h"

namespace strata::io {

/// Looks at the first bytes of `stored` (which stands at byte 0) and returns it wrapped in the
/// unpacker they call for, or as it is.
///
/// gzip: several members after each other are one stream; zeros after the last member are padding,
/// anything else there is damage. zstd: several frames are one stream, skippable frames are
/// skipped, a window above 128 MiB is kUnsupported because it would have to be held in memory.
/// Data that end inside a member or frame are kCorruptInput. Memory: fixed, besides zstd's window.
Result<std::unique_ptr<ByteSource>> Unpack(std::unique_ptr<ByteSource> stored);

}  // namespace strata::io
