// Files and folders by descriptor: what the stores share.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>

#include "core/result.h"
#include "io/fd.h"

namespace strata::server {

using io::Fd;

/// An error with the system's reason for `error` (an errno): "NAME: WHAT: REASON". ENOENT is
/// kNotFound, everything else kIo.
tl::unexpected<Error> FailSystem(const std::string& name, const std::string& what, int error);

/// The folder `name` in the open folder `parent` (AT_FDCWD: of the process), made with mode 0700 if
/// it is missing; a new one is durable on return. Errors: kNotFound (no parent), kIo.
Result<Fd> OpenFolder(int parent, const std::string& name);

/// Makes what was created, renamed or removed in an open folder durable.
Result<void> SyncFolder(const Fd& folder, const std::string& name);

/// Calls `use` with the name of every entry of an open folder but "." and "..". The names are
/// gathered first, so that `use` may remove them. Errors: kIo.
Result<void> ForEachName(int folder, const std::function<void(const std::string&)>& use);

/// The size in bytes of an open regular file. Errors: kIo; kUnsupported for what is no such file.
Result<std::uint64_t> RegularFileSize(int fd, const std::string& name);

/// SHA-256 of a file's first `size` bytes in hex. Errors: kIo, a file that ends before included.
Result<std::string> HashFile(int fd, std::uint64_t size, const std::string& name);

/// Fills `out` from byte `offset`. Errors: kIo, the file's end included.
Result<void> ReadFileAt(int fd, std::uint64_t offset, std::span<char> out, const std::string& name);

/// 32 hex digits from the system's random source: nobody guesses one, no two are equal.
std::string RandomId();

/// Whether `text` is `digits` lower-case hex digits.
bool IsHex(std::string_view text, std::size_t digits);
/// Whether `text` is a SHA-256 as the stores write it.
inline bool IsHash(std::string_view text) { return IsHex(text, 64); }

}  // namespace strata::server
