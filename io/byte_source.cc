#include "io/byte_source.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <system_error>
#include <utility>

#include "io/compressed_source.h"
#include "io/fd.h"

namespace strata::io {
namespace {

std::string SystemMessage(int error) { return std::generic_category().message(error); }

// A regular file from `start` on, by pread: a file that shrinks while it is read gives an error
// where a mapping would give SIGBUS. Bytes that are appended after opening are not seen.
class FileSource : public ByteSource {
 public:
  FileSource(Fd fd, std::uint64_t start, std::uint64_t size, std::string name)
      : fd_(std::move(fd)), start_(start), size_(size), name_(std::move(name)) {}

  Result<std::size_t> Read(std::span<char> out) override {
    if (position_ >= size_ || out.empty()) return std::size_t{0};
    const auto want =
        static_cast<std::size_t>(std::min<std::uint64_t>(out.size(), size_ - position_));
    ssize_t n;
    do {
      n = ::pread(fd_.get(), out.data(), want, static_cast<off_t>(start_ + position_));
    } while (n < 0 && errno == EINTR);
    if (n < 0) return Failure(position_, "reading failed: " + SystemMessage(errno));
    if (n == 0) {
      return Failure(position_, "the file ends here, but held " + std::to_string(size_) +
                                    " bytes when it was opened");
    }
    position_ += static_cast<std::uint64_t>(n);
    return static_cast<std::size_t>(n);
  }

  Result<void> Seek(std::uint64_t offset) override {
    position_ = offset;
    return {};
  }

  bool can_read_at() const override { return true; }
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) override {
    while (!out.empty()) {
      const ssize_t n =
          ::pread(fd_.get(), out.data(), out.size(), static_cast<off_t>(start_ + offset));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return Failure(offset, "reading failed: " + SystemMessage(errno));
      if (n == 0) return Failure(offset, "the file ends here, expected more: did it shrink?");
      offset += static_cast<std::uint64_t>(n);
      out = out.subspan(static_cast<std::size_t>(n));
    }
    return {};
  }

  std::optional<std::uint64_t> size() const override { return size_; }
  std::uint64_t stored_position() const override { return std::min(position_, size_); }
  std::optional<std::uint64_t> stored_size() const override { return size_; }
  std::string compression() const override { return "none"; }
  const std::string& name() const override { return name_; }

 private:
  tl::unexpected<Error> Failure(std::uint64_t at, const std::string& what) const {
    return Fail(ErrorCode::kIo, name_ + ": byte " + std::to_string(at) + ": " + what);
  }

  Fd fd_;
  std::uint64_t start_, size_, position_ = 0;
  std::string name_;
};

class StringSource : public ByteSource {
 public:
  StringSource(std::string bytes, std::string name)
      : bytes_(std::move(bytes)), name_(std::move(name)) {}

  Result<std::size_t> Read(std::span<char> out) override {
    const std::size_t n = std::min(out.size(), bytes_.size() - position_);
    if (n > 0) std::memcpy(out.data(), bytes_.data() + position_, n);
    position_ += n;
    return n;
  }
  Result<void> Seek(std::uint64_t offset) override {
    position_ = static_cast<std::size_t>(std::min<std::uint64_t>(offset, bytes_.size()));
    return {};
  }
  bool can_read_at() const override { return true; }
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) override {
    if (offset > bytes_.size() || out.size() > bytes_.size() - offset) {
      return ByteSource::ReadAt(offset, out);
    }
    std::copy_n(bytes_.data() + offset, out.size(), out.data());
    return {};
  }
  std::optional<std::uint64_t> size() const override { return bytes_.size(); }
  std::uint64_t stored_position() const override { return position_; }
  std::optional<std::uint64_t> stored_size() const override { return bytes_.size(); }
  std::string compression() const override { return "none"; }
  const std::string& name() const override { return name_; }

 private:
  std::string bytes_, name_;
  std::size_t position_ = 0;
};

// What a compressed source held, which says so still.
class UnpackedSource : public FileSource {
 public:
  UnpackedSource(Fd fd, std::uint64_t size, const ByteSource& packed)
      : FileSource(std::move(fd), 0, size, packed.name()), compression_(packed.compression()) {}
  std::string compression() const override { return compression_; }

 private:
  std::string compression_;
};

// Copies everything that can be read from `fd` to scratch space.
Result<std::unique_ptr<ByteSource>> Copy(const Fd& fd, const std::string& name,
                                         ScratchFolder* scratch) {
  auto copy = NewScratchFile(scratch);
  if (!copy) return Forward(copy);
  std::vector<char> buffer(std::size_t{1} << 18);
  for (;;) {
    const ssize_t n = ::read(fd.get(), buffer.data(), buffer.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) {
      return Fail(ErrorCode::kIo, name + ": byte " + std::to_string((*copy)->size()) +
                                      ": reading failed: " + SystemMessage(errno));
    }
    if (n == 0) break;
    auto written = (*copy)->Append({buffer.data(), static_cast<std::size_t>(n)});
    if (!written) return Forward(written);
  }
  const std::uint64_t size = (*copy)->size();
  return std::make_unique<FileSource>(Fd((*copy)->Release()), 0, size, name);
}

// From an open descriptor: a regular file as it is, a pipe or device through scratch space.
Result<std::unique_ptr<ByteSource>> FromDescriptor(Fd fd, const std::string& name,
                                                   std::uint64_t start, ScratchFolder* scratch) {
  struct stat status {};
  if (::fstat(fd.get(), &status) != 0) {
    return Fail(ErrorCode::kIo, name + ": " + SystemMessage(errno));
  }
  if (S_ISDIR(status.st_mode)) {
    return Fail(ErrorCode::kNotFound, name + ": found a directory, expected a file");
  }
  if (!S_ISREG(status.st_mode)) return Copy(fd, name, scratch);
  const auto end = static_cast<std::uint64_t>(std::max<off_t>(status.st_size, 0));
  ::posix_fadvise(fd.get(), 0, 0, POSIX_FADV_SEQUENTIAL);
  start = std::min(start, end);
  return std::make_unique<FileSource>(std::move(fd), start, end - start, name);
}

Result<std::unique_ptr<ByteSource>> OpenStandardInput(ScratchFolder* scratch) {
  const std::string name = "standard input";
  Fd fd(::fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 0));
  if (fd.get() < 0) return Fail(ErrorCode::kIo, name + ": " + SystemMessage(errno));
  // Redirected from a file, it may have been read in part by whoever ran before.
  const off_t at = ::lseek(fd.get(), 0, SEEK_CUR);
  return FromDescriptor(std::move(fd), name, at > 0 ? static_cast<std::uint64_t>(at) : 0, scratch);
}

Result<std::unique_ptr<ByteSource>> OpenPath(const std::string& path, ScratchFolder* scratch) {
  int raw;
  do {
    raw = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  } while (raw < 0 && errno == EINTR);
  Fd fd(raw);
  if (fd.get() < 0) {
    const bool ours = errno == EMFILE || errno == ENFILE || errno == ENOMEM || errno == EIO;
    return Fail(ours ? ErrorCode::kIo : ErrorCode::kNotFound, path + ": " + SystemMessage(errno));
  }
  return FromDescriptor(std::move(fd), path, 0, scratch);
}

}  // namespace

Result<void> ByteSource::ReadAt(std::uint64_t offset, std::span<char> out) {
  return Fail(ErrorCode::kIo, name() + ": byte " + std::to_string(offset) + ": cannot read " +
                                  std::to_string(out.size()) + " bytes here");
}

Result<std::unique_ptr<ByteSource>> OpenByteSource(const std::string& path,
                                                   ScratchFolder* scratch) {
  auto stored = path == "-" ? OpenStandardInput(scratch) : OpenPath(path, scratch);
  if (!stored) return stored;
  return Unpack(std::move(*stored));
}

Result<std::unique_ptr<ScratchFile>> NewScratchFile(ScratchFolder* scratch) {
  if (scratch != nullptr) return scratch->NewFile();
  auto systems = ScratchFolder::OpenSystems();
  if (!systems) return Forward(systems);
  return (*systems)->NewFile();
}

Result<std::unique_ptr<ByteSource>> OpenByteSource(Fd fd, const std::string& name,
                                                   ScratchFolder* scratch) {
  return FromDescriptor(std::move(fd), name, 0, scratch);
}

Result<std::unique_ptr<ByteSource>> WithReadAt(std::unique_ptr<ByteSource> source,
                                               ScratchFolder* scratch) {
  if (auto ok = source->Seek(0); !ok) return Forward(ok);
  if (source->can_read_at()) return source;
  auto copy = NewScratchFile(scratch);
  if (!copy) return Forward(copy);
  std::vector<char> buffer(std::size_t{1} << 18);
  for (;;) {
    const auto n = source->Read(buffer);
    if (!n) return Forward(n);
    if (*n == 0) break;
    if (auto ok = (*copy)->Append({buffer.data(), *n}); !ok) return Forward(ok);
  }
  const std::uint64_t size = (*copy)->size();
  return std::make_unique<UnpackedSource>(Fd((*copy)->Release()), size, *source);
}

std::unique_ptr<ByteSource> MemorySource(std::string bytes, std::string name) {
  auto stored = std::make_unique<StringSource>(std::move(bytes), std::move(name));
  // Reading memory does not fail, so only an exhausted heap can: as fatal here as in a test.
  return std::move(Unpack(std::move(stored)).value());
}

InputBuffer::InputBuffer(ByteSource& source, std::size_t capacity)
    : source_(source), buffer_(capacity) {}

Result<std::string_view> InputBuffer::Peek(std::size_t n) {
  n = std::min(n, buffer_.size());
  if (end_ - begin_ < n && !at_end_) {
    if (begin_ > 0 && end_ > begin_) {
      std::memmove(buffer_.data(), buffer_.data() + begin_, end_ - begin_);
    }
    base_ += begin_;
    end_ -= begin_;
    begin_ = 0;
    while (end_ < n && !at_end_) {
      const std::uint64_t at = base_ + end_, ahead = ahead_ > at ? ahead_ - at : 0;
      const auto most = static_cast<std::size_t>(
          std::min<std::uint64_t>(buffer_.size() - end_, std::max<std::uint64_t>(n - end_, ahead)));
      auto got = source_.Read(std::span(buffer_).subspan(end_, most));
      if (!got) return Forward(got);
      at_end_ = *got == 0;
      end_ += *got;
    }
  }
  return std::string_view(buffer_.data() + begin_, end_ - begin_);
}

void InputBuffer::Forget() {
  begin_ = end_ = 0;
  at_end_ = false;
  base_ = UINT64_MAX;
}

Result<void> InputBuffer::Seek(std::uint64_t offset) {
  if (offset >= base_ && offset - base_ <= end_) {
    begin_ = static_cast<std::size_t>(offset - base_);
    return {};
  }
  if (auto ok = source_.Seek(offset); !ok) return ok;
  base_ = offset;
  begin_ = end_ = 0;
  at_end_ = false;
  return {};
}

}  // namespace strata::io
