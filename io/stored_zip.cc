#include "io/stored_zip.h"

#include <archive.h>
#include <archive_entry.h>

#include <cerrno>
#include <string_view>

namespace strata::io {
namespace {

struct FreeEntry {
  void operator()(archive_entry* e) const { archive_entry_free(e); }
};

}  // namespace

void StoredZip::Free::operator()(archive* a) const { archive_write_free(a); }

StoredZip::StoredZip(AtomicFile& file) : file_(file), archive_(archive_write_new()) {}

StoredZip::~StoredZip() = default;

Result<void> StoredZip::Open() {
  archive* a = archive_.get();
  // Unblocked, because libarchive would pad the file to a tape's record otherwise.
  const bool good = a != nullptr && archive_write_set_format_zip(a) == ARCHIVE_OK &&
                    archive_write_zip_set_compression_store(a) == ARCHIVE_OK &&
                    archive_write_set_bytes_per_block(a, 0) == ARCHIVE_OK &&
                    archive_write_open(a, this, nullptr, &StoredZip::Take, nullptr) == ARCHIVE_OK;
  return good ? Result<void>() : Failure();
}

long StoredZip::Take(archive* a, void* self, const void* bytes, std::size_t size) {
  auto& zip = *static_cast<StoredZip*>(self);
  auto written = zip.file_.Write({static_cast<const char*>(bytes), size});
  if (written) return static_cast<long>(size);
  zip.error_ = written.error();
  archive_set_error(a, EIO, "write failed");
  return -1;
}

// Told its size first, libarchive writes zip64 where that needs it.
Result<void> StoredZip::Begin(const std::string& name, std::uint64_t bytes) {
  const std::unique_ptr<archive_entry, FreeEntry> entry(archive_entry_new());
  if (!entry) return Fail(ErrorCode::kOverBudget, file_.name() + ": out of memory");
  archive_entry_set_pathname(entry.get(), name.c_str());
  archive_entry_set_filetype(entry.get(), AE_IFREG);
  archive_entry_set_perm(entry.get(), 0644);
  // No time is set: the zip then says 1980-01-01, whatever the clock and the time zone.
  archive_entry_set_size(entry.get(), static_cast<la_int64_t>(bytes));
  return archive_write_header(archive_.get(), entry.get()) == ARCHIVE_OK ? Result<void>()
                                                                         : Failure();
}

Result<void> StoredZip::Put(std::span<const char> bytes) {
  while (!bytes.empty()) {
    const la_ssize_t n = archive_write_data(archive_.get(), bytes.data(), bytes.size());
    if (n <= 0) return Failure();
    bytes = bytes.subspan(static_cast<std::size_t>(n));
  }
  return {};
}

Result<void> StoredZip::Close() {
  return archive_write_close(archive_.get()) == ARCHIVE_OK ? Result<void>() : Failure();
}

tl::unexpected<Error> StoredZip::Failure() {
  if (error_) return tl::unexpected<Error>(*error_);
  const char* reason = archive_ ? archive_error_string(archive_.get()) : nullptr;
  return Fail(ErrorCode::kIo,
              file_.name() + ": cannot write the zip: " + (reason ? reason : "out of memory"));
}

}  // namespace strata::io
