#include "server/batch/bucket_output.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <mutex>
#include <utility>
#include <vector>

#include "io/atomic_file.h"
#include "io/fd.h"
#include "io/output_place.h"
#include "io/sample_writer.h"
#include "io/sha256.h"
#include "server/batch/bucket_calls.h"
#include "server/batch/manifest.h"
#include "server/batch/saved_files.h"
#include "server/remote/s3_client.h"
#include "server/remote/upload_journal.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;

constexpr std::chrono::hours kStale{24};
constexpr std::uint64_t kMostPicture = std::uint64_t{4} << 20;
// Of a manifest whose writing failed: it may have come about.
constexpr const char* kAnyTag = "?";
// Below the folder of state. All but these, the manifests and the pictures stays local.
constexpr const char* kJournalName = "/.strata/uploads";
constexpr const char* kSavedName = "/.strata/saved";
constexpr const char* kLockName = "/.strata/bucket-lock";
constexpr const char* kStagingName = "/.strata/outputs";
constexpr std::string_view kPictures = ".strata/pictures/";

tl::unexpected<Error> FailSystem(const std::string& name, int error) {
  return Fail(ErrorCode::kIo, name + ": " + io::SystemReason(error));
}

Result<void> MakeFolders(const std::string& path) {
  std::error_code failed;
  fs::create_directories(path, failed);
  if (failed) return Fail(ErrorCode::kIo, path + ": cannot make it: " + failed.message());
  return {};
}

/// A local file and what tells whether it has changed.
struct LocalFile {
  io::Fd fd;
  std::uint64_t size = 0;
  std::string stamp;
};

Result<LocalFile> OpenLocal(const std::string& path) {
  LocalFile file{io::Fd(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW)), 0, {}};
  struct stat status {};
  if (!file.fd || fstat(file.fd.get(), &status) != 0) return FailSystem(path, errno);
  if (!S_ISREG(status.st_mode)) return Fail(ErrorCode::kIo, path + ": expected a file");
  file.size = static_cast<std::uint64_t>(status.st_size);
  file.stamp = std::to_string(status.st_size) + '-' + std::to_string(status.st_mtim.tv_sec) + '-' +
               std::to_string(status.st_mtim.tv_nsec);
  return file;
}

class BucketOutput final : public OutputPlace {
 public:
  BucketOutput(S3Name prefix, const S3Config& config, std::string state)
      : prefix_(std::move(prefix)), config_(config), state_(std::move(state)) {}

  ~BucketOutput() override {
    std::error_code ignored;
    if (lock_) fs::remove_all(state_ + kStagingName, ignored);
  }

  Result<std::string> OpenState() override {
    if (const Result<void> made = MakeFolders(state_ + "/.strata/pictures"); !made) {
      return Forward(made);
    }
    for (const auto step : {&BucketOutput::TakeLock, &BucketOutput::ListOutputs,
                            &BucketOutput::AbortLeftovers, &BucketOutput::FetchState}) {
      if (const Result<void> done = (this->*step)(); !done) return Forward(done);
    }
    return state_;
  }

  Result<void> SaveState(bool last) override {
    const std::lock_guard lock(save_mutex_);
    std::vector<std::string> names;
    std::error_code failed;
    for (fs::directory_iterator at(state_, failed), end; !failed && at != end;
         at.increment(failed)) {
      const std::string name = at->path().filename().string();
      if (IsBatchManifest(name) || (last && name == "report.html")) names.push_back(name);
    }
    for (fs::directory_iterator at(state_ + "/.strata/pictures", failed), end; !failed && at != end;
         at.increment(failed)) {
      std::string name = std::string(kPictures) + at->path().filename().string();
      if (IsBatchPicture(name)) names.push_back(std::move(name));
    }
    if (failed) return Fail(ErrorCode::kIo, state_ + ": " + failed.message());
    // Pictures before the manifest that names them: ".strata" comes before "manifest".
    std::ranges::sort(names);
    for (const std::string& name : names) {
      if (const Result<void> saved = SaveFile(name); !saved) return saved;
    }
    return saved_.Store();
  }

  Result<std::string> LocalPath(const std::string& output) override {
    const std::string staging = state_ + kStagingName;
    if (const Result<void> made = MakeFolders(staging); !made) return Forward(made);
    return staging + '/' + StagedName(output);
  }

  Result<void> Publish(const std::string& output, const std::function<bool()>& gone) override {
    const GoneScope scope(gone);
    const std::string local = state_ + kStagingName + '/' + StagedName(output);
    std::error_code failed;
    const fs::file_type type = fs::symlink_status(local, failed).type();
    const Result<void> put =
        type == fs::file_type::directory ? PutFolder(output, local) : PutOne(output, local);
    if (!put) return put;
    // Whatever else had the name: a folder of tiles whose place a file took, tiles of a former one.
    if (const Result<void> removed = RemoveOthers(output, local, type); !removed) return removed;
    fs::remove_all(local, failed);
    return {};
  }

  Result<bool> IsThere(const std::string& output, std::uint64_t size) override {
    const std::lock_guard lock(mutex_);
    if (const auto found = sizes_.find(output); found != sizes_.end()) return found->second == size;
    if (!sizes_.contains(output + '/' + io::kTilesetName)) return false;
    std::uint64_t bytes = 0;
    for (const std::string& key : KeysBelow(output + '/')) bytes += sizes_.at(key);
    return bytes == size;
  }

  Result<void> Remove(const std::string& output) override {
    std::vector<std::string> keys;
    {
      const std::lock_guard lock(mutex_);
      if (sizes_.contains(output)) keys.push_back(output);
      const std::string tileset = output + '/' + io::kTilesetName;
      if (sizes_.contains(tileset)) {
        keys.push_back(tileset);  // First: without it, the tiles are none.
        for (std::string& key : KeysBelow(output + '/')) {
          if (key != tileset) keys.push_back(std::move(key));
        }
      }
    }
    return RemoveKeys(keys);
  }

  void Discard(const std::string&) override {
    const std::string staging = state_ + kStagingName;
    const io::Fd folder(open(staging.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder) io::RemoveLeftovers(folder.get());
  }

  std::string NameOf(const std::string& output) const override { return NameAt(output).Shown(); }

 private:
  S3Name NameAt(const std::string& name) const { return {prefix_.bucket, prefix_.key + name}; }

  /// By hash, with the suffixes by which the format is told.
  static std::string StagedName(const std::string& output) {
    const std::size_t dot = output.rfind('.');
    const bool has_suffix = dot != output.npos && output.find('/', dot) == output.npos;
    return io::Sha256Hex(output).substr(0, 40) + (has_suffix ? output.substr(dot) : "");
  }

  /// OpenState writes into the folder before a batch holds its own lock.
  Result<void> TakeLock() {
    const std::string path = state_ + kLockName;
    lock_ = io::Fd(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666));
    if (!lock_) return FailSystem(path, errno);
    if (flock(lock_.get(), LOCK_EX | LOCK_NB) == 0) {
      const std::string id = std::to_string(getpid()) + '\n';
      const bool written = ftruncate(lock_.get(), 0) == 0 &&
                           pwrite(lock_.get(), id.data(), id.size(), 0) == std::ssize(id);
      return written ? Result<void>() : FailSystem(path, errno);
    }
    if (errno != EWOULDBLOCK) {
      return errno == EOPNOTSUPP || errno == ENOLCK ? Result<void>() : FailSystem(path, errno);
    }
    std::ifstream owner(path);
    std::string id;
    owner >> id;
    lock_.Close();
    return Fail(ErrorCode::kConflict, prefix_.Shown() + ": process " + id +
                                          " of this machine writes there (its state is in " +
                                          state_ + ")");
  }

  /// Also makes the client: by then nobody else has the journal.
  Result<void> ListOutputs() {
    Result<std::unique_ptr<UploadJournal>> journal = UploadJournal::Open(state_ + kJournalName);
    if (!journal) return Forward(journal);
    journal_ = std::move(*journal);
    client_ = std::make_unique<S3Client>(config_, GoneScope::Gone, journal_.get());
    saved_.Load(state_ + kSavedName);
    return client_->List(prefix_, [&](const S3Object& object) {
      const std::string name = object.key.substr(prefix_.key.size());
      if (IsBatchManifest(name) || IsBatchPicture(name)) state_objects_[name] = object;
      sizes_[name] = object.size;
      return Result<void>();
    });
  }

  Result<void> AbortLeftovers() {
    std::error_code ignored;
    fs::remove_all(state_ + kStagingName, ignored);
    const Result<int> own = journal_->AbortLeftovers(*client_);
    if (!own) return Forward(own);
    const Result<int> stale = client_->AbortStaleUploads(prefix_, kStale);
    return stale ? Result<void>() : Forward(stale);
  }

  /// What is not the object that this machine put there has been written by another one.
  Result<void> FetchState() {
    for (const auto& [name, object] : state_objects_) {
      const SavedFiles::Entry* const saved = saved_.Find(name);
      const std::string path = state_ + '/' + name;
      std::error_code failed;
      const bool is_here = fs::exists(path, failed);
      if (IsBatchManifest(name)) known_[name] = object.etag;
      if (is_here && ((saved != nullptr && saved->etag == object.etag) || IsBatchPicture(name)))
        continue;
      const Result<void> done =
          IsBatchPicture(name) ? FetchPicture(name, object) : FetchManifest(name);
      if (!done) return done;
    }
    state_objects_.clear();
    return {};
  }

  Result<void> FetchPicture(const std::string& name, const S3Object& object) {
    const Result<std::string> bytes = client_->Get(NameAt(name), kMostPicture);
    if (!bytes) return Forward(bytes);
    Result<std::unique_ptr<io::AtomicFile>> file = io::AtomicFile::Open(state_ + '/' + name);
    if (!file) return Forward(file);
    if (const Result<void> written = (*file)->Write(*bytes); !written) return written;
    if (const auto done = (*file)->Finish(); !done) return Forward(done);
    return NoteSaved(name, object.etag);
  }

  /// Of each model, the line that was written last, here or there.
  Result<void> FetchManifest(const std::string& name) {
    const std::string path = state_ + '/' + name;
    const std::string fetched = state_ + "/.strata/fetched.jsonl";
    const io::Fd file(open(fetched.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0666));
    if (!file) return FailSystem(fetched, errno);
    const Result<S3Object> object = client_->GetToFile(NameAt(name), file.get());
    if (!object) return Forward(object);
    known_[name] = object->etag;
    if (access(path.c_str(), F_OK) != 0) {
      if (rename(fetched.c_str(), path.c_str()) != 0) return FailSystem(path, errno);
      return NoteSaved(name, object->etag);
    }
    const Result<ManifestReader> theirs = ManifestReader::Open(fetched);
    if (!theirs) return Forward(theirs);
    Result<std::unique_ptr<Manifest>> ours = Manifest::Open(path);
    if (!ours) return Forward(ours);
    const Result<void> merged = theirs->ForEach([&](ManifestLine&& line) -> Result<void> {
      const Result<std::optional<ManifestLine>> mine = (*ours)->Find(line.path);
      if (!mine) return Forward(mine);
      const bool is_newer = !*mine || (*mine)->measured.finished < line.measured.finished;
      return is_newer ? (*ours)->Append(line) : Result<void>();
    });
    unlink(fetched.c_str());
    if (!merged) return merged;
    // That of another share, as a rule: then it is not this one's to put there again.
    for (const std::string& model : (*ours)->Paths()) {
      const auto mine = (*ours)->Find(model), other = theirs->Find(model);
      if (!mine || !other) return Forward(mine ? other : mine);
      if (!*other || (*other)->measured.finished < (*mine)->measured.finished) return {};
    }
    return NoteSaved(name, object->etag);
  }

  /// What lies here is what lies there.
  Result<void> NoteSaved(const std::string& name, const std::string& etag) {
    const Result<LocalFile> local = OpenLocal(state_ + '/' + name);
    if (!local) return Forward(local);
    saved_.Set(name, {local->stamp, etag});
    return {};
  }

  Result<void> SaveFile(const std::string& name) {
    const std::string path = state_ + '/' + name;
    const Result<LocalFile> local = OpenLocal(path);
    if (!local) return access(path.c_str(), F_OK) != 0 ? Result<void>() : Forward(local);
    const SavedFiles::Entry* const saved = saved_.Find(name);
    if (saved != nullptr && saved->stamp == local->stamp) return {};
    if (const Result<void> ours = CheckUnchanged(name); !ours) return ours;
    const Result<std::string> etag = client_->PutFile(NameAt(name), local->fd.get(), local->size);
    if (IsBatchManifest(name)) known_[name] = etag ? *etag : kAnyTag;
    if (!etag) return Forward(etag);
    saved_.Set(name, {local->stamp, *etag});
    return {};
  }

  /// A batch that was paused, and taken up elsewhere meanwhile, must not put its few lines over the
  /// other's: it ends, and the next one takes the lines of both.
  Result<void> CheckUnchanged(const std::string& name) {
    if (!IsBatchManifest(name) || known_[name] == kAnyTag) return {};
    const Result<std::optional<S3Object>> there = client_->Find(NameAt(name));
    if (!there) return Forward(there);
    if (!*there || (*there)->etag.empty() || (*there)->etag == known_[name]) return {};
    return Fail(ErrorCode::kConflict, NameAt(name).Shown() +
                                          ": another process has written it since this one did, "
                                          "so it goes on with the batch; run this one again later");
  }

  Result<void> PutOne(const std::string& output, const std::string& path) {
    const Result<LocalFile> local = OpenLocal(path);
    if (!local) return Forward(local);
    const Result<std::string> etag = client_->PutFile(NameAt(output), local->fd.get(), local->size);
    if (!etag) return Forward(etag);
    const std::lock_guard lock(mutex_);
    sizes_[output] = local->size;
    return {};
  }

  Result<void> PutFolder(const std::string& output, const std::string& local) {
    const std::string tileset = output + '/' + io::kTilesetName;
    if (const Result<void> removed = RemoveKeys({tileset}); !removed) return removed;
    for (const std::string& name : FilesIn(local)) {
      const Result<void> put = PutOne(output + '/' + name, local + '/' + name);
      if (!put) return put;
    }
    return {};
  }

  /// Names below a folder, the tileset.json last.
  static std::vector<std::string> FilesIn(const std::string& folder) {
    std::vector<std::string> names;
    std::error_code failed;
    for (fs::recursive_directory_iterator at(folder, failed), end; !failed && at != end;
         at.increment(failed)) {
      if (at->is_regular_file(failed)) {
        names.push_back(at->path().lexically_relative(folder).generic_string());
      }
    }
    std::ranges::sort(names);
    std::stable_partition(names.begin(), names.end(),
                          [](const std::string& name) { return name != io::kTilesetName; });
    return names;
  }

  Result<void> RemoveOthers(const std::string& output, const std::string& local,
                            fs::file_type type) {
    std::vector<std::string> kept;
    if (type == fs::file_type::directory) {
      for (const std::string& name : FilesIn(local)) kept.push_back(output + '/' + name);
    } else {
      kept.push_back(output);
    }
    std::ranges::sort(kept);
    std::vector<std::string> others;
    {
      const std::lock_guard lock(mutex_);
      others = sizes_.contains(output + '/' + io::kTilesetName) ? KeysBelow(output + '/')
                                                                : std::vector<std::string>();
      if (sizes_.contains(output)) others.push_back(output);
    }
    std::erase_if(others,
                  [&](const std::string& key) { return std::ranges::binary_search(kept, key); });
    return RemoveKeys(others);
  }

  Result<void> RemoveKeys(const std::vector<std::string>& keys) {
    for (const std::string& key : keys) {
      {
        const std::lock_guard lock(mutex_);
        if (!sizes_.contains(key)) continue;
      }
      if (const Result<void> done = client_->Delete(NameAt(key)); !done) return done;
      const std::lock_guard lock(mutex_);
      sizes_.erase(key);
    }
    return {};
  }

  /// mutex_ is held.
  std::vector<std::string> KeysBelow(const std::string& begin) const {
    std::vector<std::string> keys;
    for (auto at = sizes_.lower_bound(begin); at != sizes_.end() && at->first.starts_with(begin);
         ++at) {
      keys.push_back(at->first);
    }
    return keys;
  }

  const S3Name prefix_;  // Its key is empty or ends with '/'.
  const S3Config config_;
  const std::string state_;
  io::Fd lock_;
  std::unique_ptr<UploadJournal> journal_;
  std::unique_ptr<S3Client> client_;
  std::map<std::string, S3Object>
      state_objects_;  // Manifests and pictures, as OpenState found them.
  std::mutex save_mutex_;
  /// The tags of manifests there, as this process read or wrote them. Guarded by save_mutex_ once
  /// the state is open.
  std::map<std::string, std::string> known_;
  SavedFiles saved_;  // Guarded by save_mutex_ once the state is open.
  std::mutex mutex_;
  std::map<std::string, std::uint64_t>
      sizes_;  // Of the objects below the prefix. Guarded by mutex_.
};

}  // namespace

bool IsBatchManifest(std::string_view name) {
  return name.starts_with("manifest") && name.ends_with(".jsonl") &&
         name.find('/') == std::string_view::npos;
}

bool IsBatchPicture(std::string_view name) {
  return name.starts_with(kPictures) && name.ends_with(".png") && WhyNotAPath(name).empty() &&
         name.find('/', kPictures.size()) == std::string_view::npos;
}

Result<std::unique_ptr<OutputPlace>> OpenBucketOutput(const std::string& url,
                                                      const S3Config& config,
                                                      const std::string& state_folder) {
  Result<S3Name> prefix = ParseS3Folder(url);
  if (!prefix) return Forward(prefix);
  return std::make_unique<BucketOutput>(std::move(*prefix), config, state_folder);
}

Result<std::string> DefaultStateFolder(const std::string& url, const std::string& share) {
  const auto read = [](const char* name) {
    const char* const value = std::getenv(name);
    return std::string(value != nullptr ? value : "");
  };
  std::string cache = read("XDG_CACHE_HOME");
  if (cache.empty() && !read("HOME").empty()) cache = read("HOME") + "/.cache";
  if (cache.empty()) {
    return Fail(ErrorCode::kInvalidArgument,
                "where to keep the state of a batch into a bucket is unknown, as neither "
                "XDG_CACHE_HOME nor HOME is set: name a folder with --state");
  }
  return cache + "/strata/batch/" + io::Sha256Hex(url + '\n' + share).substr(0, 32);
}

}  // namespace strata::server
