// Zip archives of members as they are, whose bytes do not depend on clock, time zone or machine.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "core/result.h"
#include "io/atomic_file.h"

struct archive;

namespace strata::io {

/// Writes an archive into an AtomicFile, front to back: stored members, dated 1980-01-01, zip64
/// where a size needs it. Call Open, then Begin and Put for each member, then Close. Memory: little
/// beyond a hundred bytes a member. Threads: one. Errors: kIo, kOverBudget (memory).
class StoredZip {
 public:
  explicit StoredZip(AtomicFile& file);
  ~StoredZip();
  StoredZip(const StoredZip&) = delete;
  StoredZip& operator=(const StoredZip&) = delete;

  Result<void> Open();
  /// A member of `bytes` bytes, which Put must then give, all together.
  Result<void> Begin(const std::string& name, std::uint64_t bytes);
  Result<void> Put(std::span<const char> bytes);
  /// Writes the directory. The file is the caller's to finish.
  Result<void> Close();

 private:
  struct Free {
    void operator()(archive* a) const;
  };
  static long Take(archive* a, void* self, const void* bytes, std::size_t size);
  tl::unexpected<Error> Failure();

  AtomicFile& file_;
  std::optional<Error> error_;
  std::unique_ptr<archive, Free> archive_;
};

}  // namespace strata::io
