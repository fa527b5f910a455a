#include "server/batch/bucket_source.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <map>
#include <mutex>
#include <optional>
#include <thread>
#include <unordered_map>
#include <utility>

#include "core/run_context.h"
#include "io/fd.h"
#include "io/output_place.h"
#include "io/sha256.h"
#include "server/batch/bucket_calls.h"
#include "server/remote/s3_client.h"

namespace strata::server {
namespace {

constexpr std::uint64_t kMostText = std::uint64_t{1} << 20;
constexpr std::chrono::milliseconds kTick{100};

/// A local name for what a key names: by hash, with the suffix, by which some formats are told.
std::string LocalNameOf(const std::string& key) {
  std::string name = io::Sha256Hex(key).substr(0, 40);
  const std::string_view last = std::string_view(key).substr(key.rfind('/') + 1);
  std::size_t dot = last.rfind('.');
  if (dot != last.npos && dot > 0) dot = std::min(dot, last.rfind('.', dot - 1));
  if (dot == last.npos || last.size() - dot > 24) return name;
  for (const char c : last.substr(dot)) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9');
    name += plain || c == '.' ? c : '_';
  }
  return name;
}

class BucketSource final : public ModelSource {
 public:
  BucketSource(S3Name prefix, S3Name outputs, const S3Config& config, FetchAhead ahead)
      : prefix_(std::move(prefix)),
        outputs_(std::move(outputs)),
        ahead_(std::move(ahead)),
        client_(config, [this] { return stopped_ || GoneScope::Gone(); }) {}

  ~BucketSource() override {
    stopped_ = true;
    changed_.notify_all();
    for (std::thread& thread : fetchers_) thread.join();
    std::error_code ignored;
    if (announced_) std::filesystem::remove_all(ahead_.folder, ignored);
  }

  Result<std::vector<ModelEntry>> List(const ModelFilter& filter) override {
    std::vector<ModelEntry> models;
    const Result<void> listed = client_.List(prefix_, [&](S3Object object) {
      Add(std::move(object), filter, models);
      return Result<void>();
    });
    if (!listed) return Forward(listed);
    is_listed_ = true;
    return models;
  }

  Result<std::optional<ModelEntry>> Find(const std::string& path) override {
    if (is_listed_) {
      const auto found = entries_.find(path);
      return found != entries_.end() ? std::optional(found->second) : std::nullopt;
    }
    if (!WhyNotAPath(path).empty()) return std::optional<ModelEntry>();
    const Result<std::optional<S3Object>> object = client_.Find(NameAt(path));
    if (!object) return Forward(object);
    if (!*object) return std::optional<ModelEntry>();
    return std::optional(ModelEntry{path, (*object)->size, (*object)->etag});
  }

  void Announce(std::span<const ModelEntry* const> order) override {
    for (const ModelEntry* const model : order) {
      if (WhyNotFetched(model->path).empty()) order_.push_back(model);
    }
    // By now the batch holds its lock: what lies there is a dead one's.
    announced_ = true;
    std::error_code failed;  // A folder that cannot be made shows when the first file cannot.
    std::filesystem::remove_all(ahead_.folder, failed);
    std::filesystem::create_directories(ahead_.folder, failed);
    const std::size_t count = std::min<std::size_t>(ahead_.connections, order_.size());
    for (std::size_t i = 0; i < count; ++i) fetchers_.emplace_back([this] { FetchNext(); });
  }

  Result<LocalModel> Fetch(const ModelEntry& model, const std::function<bool()>& gone) override {
    if (const std::string why = WhyNotFetched(model.path); !why.empty()) {
      return Fail(ErrorCode::kUnsupported,
                  NameOf(model.path) + ": the key cannot be a path: " + why);
    }
    {
      std::unique_lock lock(mutex_);
      Item& item = items_[model.path];
      while (item.state == State::kFetching) {
        if (gone && gone()) return Cancelled();
        changed_.wait_for(lock, kTick);
      }
      if (item.state == State::kReady) {
        item.state = State::kTaken;
        return Hand(model);
      }
      if (item.state == State::kFailed) {
        item.state = State::kTaken;  // A further try fetches anew.
        return tl::unexpected<Error>(item.error);
      }
      item.state = State::kTaken;
      used_bytes_ += model.size;
    }
    const GoneScope scope(gone);
    const Result<void> fetched = FetchNow(model);
    if (fetched) return Hand(model);
    Release(model.size);
    return Forward(fetched);
  }

  Result<std::optional<std::string>> ReadText(const std::string& path) override {
    const Result<std::optional<ModelEntry>> found = Find(path);
    if (!found) return Forward(found);
    if (!*found) return std::optional<std::string>();
    Result<std::string> text = client_.Get(NameAt(path), kMostText);
    if (!text) return Forward(text);
    return std::optional(std::move(*text));
  }

  std::string NameOf(const std::string& path) const override { return NameAt(path).Shown(); }

 private:
  enum class State { kWaiting, kFetching, kReady, kFailed, kTaken };
  struct Item {
    State state = State::kWaiting;
    Error error{};  // Of kFailed.
  };

  S3Name NameAt(const std::string& path) const {
    const auto odd = odd_keys_.find(path);
    return {prefix_.bucket, prefix_.key + (odd != odd_keys_.end() ? odd->second : path)};
  }

  std::string WhyNotFetched(const std::string& path) const {
    const auto odd = odd_keys_.find(path);
    return odd != odd_keys_.end() ? WhyNotAPath(odd->second) : std::string();
  }

  void Add(S3Object object, const ModelFilter& filter, std::vector<ModelEntry>& models) {
    const bool is_output = object.key.starts_with(outputs_.key) && !outputs_.bucket.empty();
    std::string path = object.key.substr(prefix_.key.size());
    // What programs that show folders put there for an empty one.
    const bool is_folder = (path.empty() || path.ends_with('/')) && object.size == 0;
    if (is_output || is_folder) return;
    if (!WhyNotAPath(path).empty()) {
      std::string name = '%' + PercentEncode(path, false);
      while (odd_keys_.contains(name) || entries_.contains(name)) name.insert(0, 1, '%');
      if (!Takes(filter, name)) return;
      odd_keys_[name] = std::exchange(path, name);
    }
    const bool takes = Takes(filter, path);
    ModelEntry entry{path, object.size, object.etag};
    if (takes) models.push_back(entry);
    entries_.emplace(std::move(path), std::move(entry));
  }

  std::string PathOf(const ModelEntry& model) const {
    return ahead_.folder + '/' + LocalNameOf(model.path);
  }

  /// The file of a model that has been fetched; goes when its last user does.
  LocalModel Hand(const ModelEntry& model) {
    LocalModel local{PathOf(model), nullptr};
    local.keep =
        std::shared_ptr<void>(nullptr, [this, path = local.path, size = model.size](void*) {
          unlink(path.c_str());
          Release(size);
        });
    return local;
  }

  void Release(std::uint64_t size) {
    {
      const std::lock_guard lock(mutex_);
      used_bytes_ -= size;
    }
    changed_.notify_all();
  }

  Result<void> FetchNow(const ModelEntry& model) {
    const std::string path = PathOf(model);
    const io::Fd file(open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
    if (!file) {
      return Fail(ErrorCode::kIo, path + ": cannot make it: " + io::SystemReason(errno));
    }
    const Result<S3Object> object = client_.GetToFile(NameAt(model.path), file.get());
    if (object) return {};
    unlink(path.c_str());
    return Forward(object);
  }

  /// The next model in order, as soon as there is room for it. Nothing: no more, or stopped.
  const ModelEntry* NextToFetch() {
    std::unique_lock lock(mutex_);
    while (!stopped_) {
      while (next_ < order_.size() && items_[order_[next_]->path].state != State::kWaiting) ++next_;
      if (next_ == order_.size()) return nullptr;
      const ModelEntry* const model = order_[next_];
      if (used_bytes_ + model->size <= ahead_.max_bytes) {
        items_[model->path].state = State::kFetching;
        used_bytes_ += model->size;
        ++next_;
        return model;
      }
      changed_.wait_for(lock, kTick);
    }
    return nullptr;
  }

  void FetchNext() {
    while (const ModelEntry* const model = NextToFetch()) {
      Result<void> fetched = FetchNow(*model);
      {
        const std::lock_guard lock(mutex_);
        Item& item = items_[model->path];
        item.state = fetched ? State::kReady : State::kFailed;
        if (!fetched) item.error = std::move(fetched.error());
        if (!fetched) used_bytes_ -= model->size;
      }
      changed_.notify_all();
    }
  }

  const S3Name prefix_;   // Its key is empty or ends with '/'.
  const S3Name outputs_;  // The same; no bucket: elsewhere.
  const FetchAhead ahead_;
  std::atomic<bool> stopped_{false};
  S3Client client_;
  bool is_listed_ = false, announced_ = false;
  std::unordered_map<std::string, ModelEntry> entries_;  // Of a list: all.
  std::map<std::string, std::string> odd_keys_;  // Keys that are no paths, by their names here.
  std::vector<const ModelEntry*> order_;
  std::vector<std::thread> fetchers_;
  std::mutex mutex_;
  std::condition_variable changed_;
  // Guarded by mutex_:
  std::unordered_map<std::string, Item> items_;
  std::size_t next_ = 0;
  std::uint64_t used_bytes_ = 0;
};

}  // namespace

Result<std::unique_ptr<ModelSource>> OpenBucketSource(const std::string& url,
                                                      const std::string& outputs,
                                                      const S3Config& config,
                                                      const FetchAhead& ahead) {
  Result<S3Name> prefix = ParseS3Folder(url);
  if (!prefix) return Forward(prefix);
  S3Name output_prefix;
  if (IsS3Url(outputs)) {
    Result<S3Name> parsed = ParseS3Folder(outputs);
    if (!parsed) return Forward(parsed);
    const bool same_bucket = parsed->bucket == prefix->bucket;
    if (same_bucket && prefix->key.starts_with(parsed->key)) {
      return Fail(ErrorCode::kInvalidArgument, "the outputs would mix with the models of " +
                                                   prefix->Shown() + ": name another prefix");
    }
    if (same_bucket) output_prefix = std::move(*parsed);
  }
  return std::make_unique<BucketSource>(std::move(*prefix), std::move(output_prefix), config,
                                        ahead);
}

}  // namespace strata::server
