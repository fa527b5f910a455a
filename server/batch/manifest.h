// What became of each model of a batch, one line of JSON a model (docs/batch.md).
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "core/result.h"
#include "io/fd.h"

namespace strata::server {

/// A file that a model's mesh asked for.
struct CompanionEntry {
  std::string path;  ///< Below the folder of the model.
  std::uint64_t size = 0;
  std::string stamp;  ///< ModelEntry::stamp; empty: it was not there.
};

/// One model's line. What a failed one does not have is empty or 0.
struct ManifestLine {
  std::string path;
  bool sampled = false;
  bool gone =
      false;  ///< Pruned, where a manifest of another share still has a line. No more is set.
  std::string input_sha256;
  std::uint64_t input_bytes = 0;
  std::string stamp;  ///< ModelEntry::stamp.
  std::vector<CompanionEntry> companions;
  std::string version;  ///< Of Strata.
  std::string options;  ///< ModelOptions::json.

  std::string output;  ///< Below the place of the outputs.
  std::uint64_t output_bytes = 0;
  std::string output_sha256;
  std::uint64_t samples = 0, cells = 0, triangles = 0;
  double edge = 0, area = 0;
  std::map<std::string, std::uint64_t> skipped;  ///< By reason, those that are not 0.
  std::vector<std::string> left_out;             ///< SampleStats::left_out.
  std::string surface_hash;
  std::string picture;  ///< Below the folder of state; empty: none.

  /// Of a model that failed: the type of a problem (server/exit_codes.h), or "timed-out", "crashed"
  /// or "killed"; and a message.
  std::string error_type, error_message;

  /// Measured: what may differ between runs that do the same.
  struct Measured {
    double seconds = 0;
    std::uint64_t peak_memory_bytes = 0;  ///< Of the worker.
    std::int64_t worker = 0;              ///< Its process id.
    int attempts = 1;
    std::string finished;  ///< UTC, RFC 3339 with milliseconds.
  } measured;
};

/// Now, as ManifestLine::Measured::finished has it.
std::string InstantNow();

/// The line without its end.
std::string ToJsonLine(const ManifestLine& line);
/// Only what ToJsonLine could have written is one: names of outputs and pictures are those of the
/// path, so that whoever may write into a folder of outputs has no batch replace or remove other
/// files. Errors: kCorruptInput, without a name of the file.
Result<ManifestLine> FromJsonLine(std::string_view text);

/// A manifest file: by path, the last line of each. Keeps the lines' places, not the lines.
class ManifestReader {
 public:
  /// A file that is not there is an empty one. A last line that is not whole is left out: its
  /// writer was killed. Errors: kIo; kCorruptInput with the line's number.
  static Result<ManifestReader> Open(const std::string& path);

  /// Errors: kIo, kCorruptInput.
  Result<std::optional<ManifestLine>> Find(const std::string& path) const;
  /// In order of the paths' bytes. `take` may end it with an error of its own.
  Result<void> ForEach(const std::function<Result<void>(ManifestLine&&)>& take) const;
  std::size_t size() const { return places_.size(); }
  bool Has(const std::string& path) const { return places_.contains(path); }
  /// In order of their bytes.
  std::vector<std::string> Paths() const;

 private:
  friend class Manifest;
  struct Place {
    std::uint64_t offset = 0;
    std::uint32_t bytes = 0;  // Without the line end.
  };
  Result<void> Scan();
  Result<std::string> Read(const Place& place) const;

  std::string name_;
  io::Fd file_;
  std::map<std::string, Place> places_;
  std::uint64_t end_ = 0;  // Of the last whole line.
};

/// The manifest that a batch writes. A line that Append has taken survives the process; a thread of
/// its own makes it survive the machine as well, soon after. Threads: any.
class Manifest {
 public:
  /// Errors: those of ManifestReader::Open.
  static Result<std::unique_ptr<Manifest>> Open(const std::string& path);
  ~Manifest();
  Manifest(const Manifest&) = delete;
  Manifest& operator=(const Manifest&) = delete;

  /// Errors: kIo; then the file is as it was.
  Result<void> Append(const ManifestLine& line);
  Result<std::optional<ManifestLine>> Find(const std::string& path) const;
  /// Every path that has a line.
  std::vector<std::string> Paths() const;
  /// Leaves the path's line out of what Rewrite writes.
  void Forget(const std::string& path);
  /// Writes the file anew, one line a path, in order of the paths' bytes: whole or not at all.
  Result<void> Rewrite();

 private:
  explicit Manifest(ManifestReader reader) : reader_(std::move(reader)) {}
  void SyncNowAndThen();

  mutable std::mutex mutex_;
  ManifestReader reader_;
  std::condition_variable wake_;
  bool written_ = false, stopped_ = false;
  std::thread syncer_;
};

/// Where the last whole line of `size` bytes that `read` gives ends; 0 if there is none. Errors:
/// those of `read`.
Result<std::uint64_t> EndOfLines(
    const std::function<Result<void>(std::uint64_t offset, std::span<char> out)>& read,
    std::uint64_t size);

}  // namespace strata::server
