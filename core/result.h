// How expected failures travel: as values, never as exceptions.
#pragma once

#include <cstdint>
#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace strata {

/// The few kinds of failure a caller can act on. One table (server/exit_codes.h) maps each to an
/// exit status and to wire codes.
enum class ErrorCode : std::uint8_t {
  kInvalidArgument,  ///< An option or argument is out of its range, or two contradict each other.
  kNotFound,         ///< The input does not exist or may not be opened.
  kCorruptInput,     ///< The input contradicts its own format: truncated, bad number, bad header.
  kUnsupported,      ///< The input is a format, or uses a feature, that Strata does not read.
  kEmptySurface,     ///< The input is valid, and holds no triangle of positive area.
  kOverBudget,       ///< The work does not fit a limit (memory, lattice size, Draco's own limits).
  kIo,               ///< The operating system refused a read or write (disk full included).
  kCancelled,        ///< The caller asked to stop.
  kConflict,         ///< What is stored, or who owns it, contradicts the request.
  kInternal,         ///< A defect in Strata.
};
inline constexpr int kErrorCodeCount = 10;

/// Tells failures of one code apart for callers who do something else about each. Told by its
/// address: whoever makes such failures defines an object for each kind, as a constant.
struct ErrorKind {};

/// A failure: its code, and a message for a person that names file, offset or line, what was found
/// and what was expected.
struct Error {
  ErrorCode code = ErrorCode::kInternal;
  std::string message;
  const ErrorKind* kind = nullptr;  ///< Null: its code says all. Lives as long as the program.
};

/// Either a `T` or an `Error`. Must be looked at.
template <class T>
class [[nodiscard]] Result : public tl::expected<T, Error> {
 public:
  using tl::expected<T, Error>::expected;
};

/// Makes the error side of a Result: `return Fail(ErrorCode::kIo, "…");`
inline tl::unexpected<Error> Fail(ErrorCode code, std::string message,
                                  const ErrorKind* kind = nullptr) {
  return tl::unexpected<Error>(Error{code, std::move(message), kind});
}

/// Passes the error of one Result on as the error of another.
template <class T>
tl::unexpected<Error> Forward(const Result<T>& failed) {
  return tl::unexpected<Error>(failed.error());
}

}  // namespace strata
