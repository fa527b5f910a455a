#include "io/zip_archive.h"

#include <archive.h>
#include <archive_entry.h>

#include <algorithm>
#include <utility>

#include "io/quote.h"

namespace strata::io {
namespace {

constexpr std::size_t kMostMembers = 65536;
constexpr std::uint64_t kMostRatio = 200, kAlwaysAllowed = std::uint64_t{64} << 20;
constexpr std::uint64_t kMostBytes = std::uint64_t{1} << 40;
constexpr std::size_t kBufferBytes = std::size_t{1} << 16;

// libarchive over a ByteSource; one pass over the members.
class Pass {
 public:
  explicit Pass(ByteSource& source) : source_(source), archive_(archive_read_new()) {}

  Result<void> Open() {
    if (archive_ == nullptr)
      return Fail(ErrorCode::kOverBudget, source_.name() + ": out of memory");
    archive* const a = archive_.get();
    // The archive's directory decides what is in it, not what stands between the members.
    archive_read_support_format_zip_seekable(a);
    archive_read_set_callback_data(a, this);
    archive_read_set_read_callback(a, &Pass::Read);
    archive_read_set_seek_callback(a, &Pass::Seek);
    archive_read_set_skip_callback(a, &Pass::Skip);
    return archive_read_open1(a) == ARCHIVE_OK ? Result<void>() : Failure("expected a ZIP archive");
  }

  // Goes to the next member; null at the end.
  Result<archive_entry*> Next() {
    archive_entry* entry = nullptr;
    const int outcome = archive_read_next_header(archive_.get(), &entry);
    if (outcome == ARCHIVE_EOF) return static_cast<archive_entry*>(nullptr);
    if (outcome != ARCHIVE_OK && outcome != ARCHIVE_WARN) return Failure("the archive is damaged");
    return entry;
  }

  // Up to out.size() bytes of the member; 0 at its end.
  Result<std::size_t> Data(std::span<char> out) {
    const la_ssize_t n = archive_read_data(archive_.get(), out.data(), out.size());
    if (n < 0) return Failure("a member is damaged");
    return static_cast<std::size_t>(n);
  }

 private:
  struct Free {
    void operator()(archive* a) const { archive_read_free(a); }
  };

  tl::unexpected<Error> Failure(const std::string& what) {
    if (error_) return tl::unexpected<Error>(*error_);
    const char* const why = archive_ ? archive_error_string(archive_.get()) : nullptr;
    return Fail(ErrorCode::kCorruptInput,
                source_.name() + ": " + what + (why != nullptr ? std::string(": ") + why : ""));
  }

  static la_ssize_t Read(archive* a, void* self, const void** bytes) {
    auto& pass = *static_cast<Pass*>(self);
    const std::uint64_t size = pass.source_.size().value_or(0);
    const std::uint64_t left = size - std::min(pass.at_, size);
    const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(left, kBufferBytes));
    pass.buffer_.resize(kBufferBytes);
    auto read = pass.source_.ReadAt(pass.at_, std::span(pass.buffer_).first(n));
    if (!read) {
      pass.error_ = read.error();
      archive_set_error(a, -1, "%s", "reading failed");
      return -1;
    }
    pass.at_ += n;
    *bytes = pass.buffer_.data();
    return static_cast<la_ssize_t>(n);
  }
  static la_int64_t Seek(archive*, void* self, la_int64_t offset, int whence) {
    auto& pass = *static_cast<Pass*>(self);
    const auto size = static_cast<la_int64_t>(pass.source_.size().value_or(0));
    const la_int64_t from = whence == SEEK_SET   ? 0
                            : whence == SEEK_CUR ? static_cast<la_int64_t>(pass.at_)
                                                 : size;
    if (offset < -from || offset > size - from) return ARCHIVE_FATAL;
    pass.at_ = static_cast<std::uint64_t>(from + offset);
    return from + offset;
  }
  static la_int64_t Skip(archive*, void* self, la_int64_t n) {
    auto& pass = *static_cast<Pass*>(self);
    const auto left = static_cast<la_int64_t>(pass.source_.size().value_or(0) - pass.at_);
    const la_int64_t skipped = std::clamp<la_int64_t>(n, 0, left);
    pass.at_ += static_cast<std::uint64_t>(skipped);
    return skipped;
  }

  ByteSource& source_;
  std::unique_ptr<archive, Free> archive_;
  std::uint64_t at_ = 0;
  std::vector<char> buffer_;
  std::optional<Error> error_;
};

// A member's name as its bytes are; "" where it has none or is no regular file.
std::string NameOf(archive_entry* entry) {
  if (archive_entry_filetype(entry) != AE_IFREG) return "";
  const char* name = archive_entry_pathname(entry);
  if (name == nullptr) name = archive_entry_pathname_utf8(entry);
  std::string text = name == nullptr ? "" : name;
  while (text.starts_with("./")) text.erase(0, 2);
  return text;
}

// What a member turned out to hold, and how it was packed.
class MemberSource : public ByteSource {
 public:
  MemberSource(std::unique_ptr<ByteSource> bytes, std::string name)
      : bytes_(std::move(bytes)), name_(std::move(name)) {}
  Result<std::size_t> Read(std::span<char> out) override { return bytes_->Read(out); }
  Result<void> Seek(std::uint64_t offset) override { return bytes_->Seek(offset); }
  bool can_read_at() const override { return true; }
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) override {
    return bytes_->ReadAt(offset, out);
  }
  std::optional<std::uint64_t> size() const override { return bytes_->size(); }
  std::uint64_t stored_position() const override { return bytes_->stored_position(); }
  std::optional<std::uint64_t> stored_size() const override { return bytes_->stored_size(); }
  std::string compression() const override { return "zip"; }
  const std::string& name() const override { return name_; }

 private:
  std::unique_ptr<ByteSource> bytes_;
  std::string name_;
};

class ArchiveFiles : public CompanionFiles {
 public:
  ArchiveFiles(std::shared_ptr<ZipArchive> archive, std::string folder)
      : archive_(std::move(archive)), folder_(std::move(folder)) {}
  Result<std::unique_ptr<ByteSource>> Open(const std::string& relative,
                                           const std::string& who) const override {
    std::string plain = relative;
    while (plain.starts_with("./")) plain.erase(0, 2);
    const std::string name = folder_.empty() ? plain : folder_ + '/' + plain;
    if (archive_->Has(name)) return archive_->Extract(name);
    return Fail(ErrorCode::kNotFound, who + ": the archive has no " + Quoted(name));
  }

 private:
  std::shared_ptr<ZipArchive> archive_;
  std::string folder_;
};

}  // namespace

Result<std::shared_ptr<ZipArchive>> ZipArchive::Open(std::unique_ptr<ByteSource> source,
                                                     ScratchFolder* scratch,
                                                     const RunContext* context) {
  std::shared_ptr<ZipArchive> zip(new ZipArchive(std::move(source), scratch, context));
  if (auto ok = zip->List(); !ok) return Forward(ok);
  return zip;
}

Result<void> ZipArchive::List() {
  Pass pass(*source_);
  if (auto ok = pass.Open(); !ok) return ok;
  for (std::size_t members = 0;; ++members) {
    const auto entry = pass.Next();
    if (!entry) return Forward(entry);
    if (*entry == nullptr) return {};
    if (members == kMostMembers) {
      return Fail(ErrorCode::kOverBudget,
                  name() + ": more than " + std::to_string(kMostMembers) + " members");
    }
    std::string member = NameOf(*entry);
    if (!member.empty()) names_.push_back(std::move(member));
  }
}

bool ZipArchive::Has(const std::string& name) const {
  return std::find(names_.begin(), names_.end(), name) != names_.end();
}

std::uint64_t ZipArchive::MostUnpacked() const {
  const std::uint64_t size = this->size();
  const std::uint64_t ratio = size > kMostBytes / kMostRatio ? kMostBytes : size * kMostRatio;
  return std::min(std::max(ratio, kAlwaysAllowed), kMostBytes);
}

Result<void> ZipArchive::Stream(const std::string& wanted,
                                const std::function<Result<void>(std::span<const char>)>& take) {
  const std::string who = name() + '#' + wanted;
  if (std::count(names_.begin(), names_.end(), wanted) > 1) {
    return Fail(ErrorCode::kCorruptInput, who + ": the archive has several members of this name");
  }
  Pass pass(*source_);
  if (auto ok = pass.Open(); !ok) return ok;
  for (;;) {
    const auto entry = pass.Next();
    if (!entry) return Forward(entry);
    if (*entry == nullptr) return Fail(ErrorCode::kNotFound, who + ": not in the archive");
    if (NameOf(*entry) != wanted) continue;
    if (archive_entry_is_encrypted(*entry) != 0) {
      return Fail(ErrorCode::kUnsupported, who + ": is encrypted");
    }
    break;
  }
  std::vector<char> buffer(kBufferBytes);
  for (;;) {
    if (context_ != nullptr && context_->cancelled()) return Cancelled();
    const auto n = pass.Data(buffer);
    if (!n) return Fail(n.error().code, who + ": " + n.error().message);
    if (*n == 0) return {};
    unpacked_ += *n;
    if (unpacked_ > MostUnpacked()) {
      return Fail(ErrorCode::kOverBudget, who + ": unpacked, the archive exceeds " +
                                              std::to_string(MostUnpacked()) + " bytes, " +
                                              std::to_string(kMostRatio) + " times its size");
    }
    if (auto ok = take({buffer.data(), *n}); !ok) return ok;
  }
}

Result<std::unique_ptr<ByteSource>> ZipArchive::Extract(const std::string& wanted) {
  auto file = NewScratchFile(scratch_);
  if (!file) return Forward(file);
  auto copied = Stream(wanted, [&](std::span<const char> bytes) {
    return (*file)->Append({bytes.data(), bytes.size()});
  });
  if (!copied) return Forward(copied);
  const std::string who = name() + '#' + wanted;
  auto source = OpenByteSource(Fd((*file)->Release()), who, scratch_);
  if (!source) return source;
  return std::make_unique<MemberSource>(std::move(*source), who);
}

std::shared_ptr<const CompanionFiles> FilesInArchive(std::shared_ptr<ZipArchive> archive,
                                                     std::string folder) {
  return std::make_shared<ArchiveFiles>(std::move(archive), std::move(folder));
}

}  // namespace strata::io
