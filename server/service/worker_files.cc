#include "server/service/worker_files.h"

#include <fcntl.h>
#include <sys/stat.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <vector>

#include "core/memory_account.h"
#include "io/sha256.h"
#include "server/memory.h"
#include "server/service/file_stamp.h"
#include "server/store/file.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;

/// Resident bytes beyond which what the allocator keeps is given back.
constexpr std::uint64_t kMuch = std::uint64_t{96} << 20;

std::uint64_t ResidentBytes() {
  std::ifstream pages("/proc/self/statm");
  std::uint64_t all = 0, resident = 0;
  pages >> all >> resident;
  return resident * 4096;
}

/// From here on PeakMemoryBytes counts anew.
void ForgetPeak() { std::ofstream("/proc/self/clear_refs") << '5'; }

struct Hashed {
  std::string sha256;
  std::uint64_t bytes = 0;
  std::string state;  // Device, inode, size, time: of an unchanged file unchanged.
};

std::string StateOf(const struct stat& status) {
  return std::to_string(status.st_dev) + ' ' + std::to_string(status.st_size) + ' ' +
         StampOf(status);
}

Result<Hashed> HashPath(const std::string& path, const std::string& name) {
  const Fd file(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!file) return FailSystem(name, "cannot be opened", errno);
  struct stat status {};
  if (fstat(file.get(), &status) != 0) return FailSystem(name, "cannot be looked at", errno);
  Hashed hashed;
  hashed.bytes = static_cast<std::uint64_t>(status.st_size);
  hashed.state = StateOf(status);
  auto sha256 = HashFile(file.get(), hashed.bytes, name);
  if (!sha256) return Forward(sha256);
  hashed.sha256 = *std::move(sha256);
  return hashed;
}

}  // namespace

Result<std::string> HashOutput(const std::string& path) {
  std::error_code failed;
  if (!fs::is_directory(path, failed)) {
    auto hashed = HashPath(path, "the output");
    if (!hashed) return Forward(hashed);
    return hashed->sha256;
  }
  std::vector<std::string> names;
  for (fs::recursive_directory_iterator at(path, failed), end; !failed && at != end;
       at.increment(failed)) {
    if (at->is_regular_file()) names.push_back(at->path().lexically_relative(path).string());
  }
  if (failed) return FailSystem("the output", "cannot be listed", failed.value());
  std::ranges::sort(names);
  std::string lines;
  for (const std::string& name : names) {
    auto hashed = HashPath(path + '/' + name, "the output's " + name);
    if (!hashed) return Forward(hashed);
    lines += hashed->sha256 + "  " + name + '\n';
  }
  return io::Sha256Hex(lines);
}

JobFiles::JobFiles(const internal::WorkerJob& job) : job_(job) {
  if (!job.hash()) return;
  const fs::path folder = fs::path(job.input()).parent_path();
  companions_ = std::make_shared<CompanionsSeen>(folder.empty() ? "." : folder.string());
}

bool JobFiles::Begin() {
  if (!job_.hash()) return true;
  ForgetPeak();
  begun_ = HashInput();
  unchanged_ = begun_ && !job_.known_sha256().empty() && input_sha256_ == job_.known_sha256();
  return begun_ && !unchanged_;
}

Result<void> JobFiles::HashInput() {
  auto hashed = HashPath(job_.input(), job_.input_name());
  if (!hashed) return Forward(hashed);
  input_sha256_ = std::move(hashed->sha256);
  input_bytes_ = hashed->bytes;
  input_state_ = std::move(hashed->state);
  return {};
}

Result<void> JobFiles::Finish(Result<void> outcome, internal::WorkerFigures& figures) {
  if (!job_.hash()) return outcome;
  if (!begun_) outcome = begun_;
  struct stat status {};
  const bool same = stat(job_.input().c_str(), &status) == 0 && StateOf(status) == input_state_;
  if (begun_ && !same) {
    outcome = Fail(ErrorCode::kIo, job_.input_name() + ": changed while it was read");
  }
  figures.set_input_sha256(input_sha256_);
  figures.set_input_bytes(input_bytes_);
  figures.set_unchanged(unchanged_);
  companions_->AddTo(figures);
  if (outcome && !unchanged_) {
    auto hash = HashOutput(job_.output());
    if (hash) figures.set_output_sha256(*hash);
    if (!hash) outcome = Forward(hash);
  }
  figures.set_peak_memory_bytes(PeakMemoryBytes());
  if (ResidentBytes() > kMuch) ReturnFreedMemory();
  figures.set_resident_bytes(ResidentBytes());
  return outcome;
}

}  // namespace strata::server
