// What the sample writers of all formats share: the checks of the contract, and one output file.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "core/samples.h"
#include "io/atomic_file.h"

namespace strata::io {

/// Holds the callers to the contract of SampleWriter, so that a format's writer sees only columns
/// that match the header, never more samples than announced, and Complete only at the right count.
class CheckedWriter : public SampleWriter {
 public:
  /// `name` begins the messages.
  CheckedWriter(std::string name, SampleHeader header)
      : name_(std::move(name)), header_(std::move(header)) {}

  /// Errors: kInternal when a column's length or the number of samples contradicts the header, or
  /// a position is not finite; those of Append.
  Result<void> Write(const SampleColumns& columns) final;
  Result<std::uint64_t> Finish() final;

 protected:
  virtual Result<void> Append(const SampleColumns& columns) = 0;
  /// Writes what is still to be written and finishes the output.
  virtual Result<std::uint64_t> Complete() = 0;

  /// Errors: kInternal when a sample lies outside the header's bounds.
  Result<void> CheckInside(const SampleColumns& columns) const;
  const std::string& name() const { return name_; }
  const SampleHeader& header() const { return header_; }
  bool has(Attribute attribute) const { return (header_.attributes & attribute) != 0; }

 private:
  tl::unexpected<Error> FailInternal(const std::string& what) const;

  std::string name_;
  SampleHeader header_;
  std::uint64_t written_ = 0;
};

/// A CheckedWriter whose output is one file.
class FileWriter : public CheckedWriter {
 public:
  FileWriter(std::unique_ptr<AtomicFile> file, SampleHeader header)
      : CheckedWriter(file->name(), std::move(header)), file_(std::move(file)) {}

 protected:
  Result<std::uint64_t> Complete() override { return file_->Finish(); }
  AtomicFile& file() { return *file_; }

 private:
  std::unique_ptr<AtomicFile> file_;
};

}  // namespace strata::io
