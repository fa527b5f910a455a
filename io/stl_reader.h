// Reading STL files.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>

#include "core/mesh_reader.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"

namespace strata::io {

/// True if `size` is what a binary file's own count, which must stand in `head`, calls for.
bool HasBinaryStlSize(std::string_view head, std::optional<std::uint64_t> size);

/// For streams of unknown size: true if the first facets of a binary file could stand in `head`,
/// that is if their numbers are of a likely size. A guess: noise fails it, not every other format.
bool CouldBeBinaryStl(std::string_view head);

/// Tells binary from ascii by the file's first bytes (all of them, or a few thousand at least) and
/// its size, if known: binary files too may begin with "solid". True if HasBinaryStlSize, or, that
/// failing, if `head` cannot be an ascii file's.
bool IsBinaryStl(std::string_view head, std::optional<std::uint64_t> size);

/// Opens an STL file whose first byte is `source`'s first. There is no vertex list; coordinates are
/// single precision.
///
/// Ascii: any number of solids; keywords in either case, each on its line; what follows a keyword
/// other than `vertex` is a name, or a normal, which is not looked at. Every solid must be closed.
/// Binary: the facets counted in the header must be there. Behind them only white space and zeros
/// may follow, which is what writers pad with: more facets than counted contradict the count.
/// Errors: kCorruptInput, kIo.
Result<std::unique_ptr<MeshReader>> OpenStl(std::unique_ptr<ByteSource> source,
                                            const OpenOptions& options);

}  // namespace strata::io
