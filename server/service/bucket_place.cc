#include "server/service/bucket_place.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <utility>

#include "server/remote/s3_client.h"
#include "server/remote/upload_journal.h"

namespace strata::server {
namespace {

using SteadyClock = std::chrono::steady_clock;
constexpr std::chrono::seconds kAskEvery{1};  // While it is away.
constexpr std::chrono::seconds kFreshFor{2};  // An answer says that long that it is there.
constexpr int kProbeAttempts = 2, kProbeStallSeconds = 5;
constexpr const char* kProbe = "store-id";  // The mark of the store, which is there.

class BucketPlace final : public ObjectPlace {
 public:
  BucketPlace(S3Name prefix, const S3Config& config, std::unique_ptr<UploadJournal> journal)
      : prefix_(std::move(prefix)),
        journal_(std::move(journal)),
        client_(
            config, [] { return Meanwhile::Gone(); }, journal_.get()),
        probe_(OfProbes(config), [] { return Meanwhile::Gone(); }) {}

  /// Nothing that fails here is lost: the next process finds it in the journal again.
  void AbortLeftovers() { static_cast<void>(journal_->AbortLeftovers(client_)); }

  std::string Shown(const std::string& name) const override { return NameOf(name).Shown(); }

  Result<void> Put(const std::string& name, int fd, std::uint64_t offset,
                   std::uint64_t size) override {
    if (auto open = Gate(); !open) return open;
    return AsVoid(Heard(client_.PutFile(NameOf(name), fd, size, offset)));
  }
  Result<void> PutText(const std::string& name, std::string_view text) override {
    if (auto open = Gate(); !open) return open;
    return AsVoid(Heard(client_.Put(NameOf(name), text)));
  }
  Result<std::optional<Version>> FindVersion(const std::string& name) override {
    if (auto open = Gate(); !open) return Forward(open);
    const auto found = Heard(client_.Find(NameOf(name)));
    if (!found) return Forward(found);
    return *found ? std::optional(Version{(*found)->size, (*found)->etag})
                  : std::optional<Version>();
  }
  Result<void> Fetch(const std::string& name, int fd, std::uint64_t max_bytes) override {
    if (auto open = Gate(); !open) return open;
    return AsVoid(OfObject(name, client_.GetToFile(NameOf(name), fd, max_bytes)));
  }
  Result<void> Read(const std::string& name, std::uint64_t offset, std::span<char> out,
                    const std::string& tag) override {
    if (auto open = Gate(); !open) return open;
    auto read = client_.ReadAt(NameOf(name), offset, out, tag);
    // What was replaced is no sign of a bucket that is away.
    if (!read && !tag.empty() && read.error().code == ErrorCode::kConflict) return read;
    return OfObject(name, std::move(read));
  }
  Result<void> Delete(const std::string& name) override {
    if (auto open = Gate(); !open) return open;
    return Heard(client_.Delete(NameOf(name)));
  }
  Result<void> List(
      const std::string& prefix,
      const std::function<void(const std::string& name, std::uint64_t size)>& use) override {
    if (auto open = Gate(); !open) return open;
    return Heard(client_.List(NameOf(prefix), [&](const S3Object& object) -> Result<void> {
      use(object.key.substr(prefix_.key.size()), object.size);
      return {};
    }));
  }
  Result<std::vector<UnfinishedPut>> Unfinished() override {
    if (auto open = Gate(); !open) return Forward(open);
    auto found = client_.ListUploads(prefix_);
    std::vector<UnfinishedPut> puts;
    // What such a store is left with, its own rules for the life of objects must end.
    if (!found && found.error().code == ErrorCode::kUnsupported) return puts;
    found = Heard(std::move(found));
    if (!found) return Forward(found);
    for (const S3Upload& upload : found->uploads) {
      puts.push_back({upload.key.substr(prefix_.key.size()), upload.id});
    }
    return puts;
  }
  Result<void> Abort(const UnfinishedPut& put) override {
    if (auto open = Gate(); !open) return open;
    return Heard(client_.AbortUpload(NameOf(put.name), put.id));
  }

  bool away() const override { return away_; }

  Result<void> Check() override {
    {
      const std::lock_guard lock(mutex_);
      if (!away_ && SteadyClock::now() - heard_ < kFreshFor) return {};
    }
    return away_ ? Gate() : Ask();
  }

 private:
  S3Name NameOf(const std::string& name) const { return {prefix_.bucket, prefix_.key + name}; }

  template <class T>
  static Result<void> AsVoid(const Result<T>& result) {
    return result ? Result<void>() : Result<void>(Forward(result));
  }

  /// Fails at once while the bucket is away, but for one caller a second, who asks it.
  Result<void> Gate() {
    if (!away_) return {};
    {
      const std::lock_guard lock(mutex_);
      if (asking_ || SteadyClock::now() < ask_again_) return tl::unexpected<Error>(reason_);
      asking_ = true;
    }
    auto asked = Ask();
    const std::lock_guard lock(mutex_);
    asking_ = false;
    return asked;
  }

  /// Whoever probes waits for seconds, not for as long as a transfer may stall again and again.
  static S3Config OfProbes(S3Config config) {
    config.max_attempts = std::min(config.max_attempts, kProbeAttempts);
    config.stall_seconds = std::min(config.stall_seconds, kProbeStallSeconds);
    return config;
  }

  /// Of a bucket that is not there HEAD says the same as of a missing object.
  Result<void> Ask() {
    auto found = probe_.Find(NameOf(kProbe));
    if (found && !*found) {
      return Heard(Result<void>(Fail(ErrorCode::kIo, Shown(kProbe) + ": is not there any more")));
    }
    return AsVoid(Heard(std::move(found)));
  }

  /// Notes whether the bucket answered, and says of what did not succeed that it is away.
  template <class T>
  Result<T> Heard(Result<T> result) {
    const std::lock_guard lock(mutex_);
    if (result) {
      away_ = false;
      heard_ = SteadyClock::now();
      return result;
    }
    const ErrorCode code = result.error().code;
    if (code == ErrorCode::kCancelled || code == ErrorCode::kOverBudget) return result;
    reason_ = {ErrorCode::kIo, std::string(kBucketAway) + result.error().message};
    away_ = true;
    ask_again_ = SteadyClock::now() + kAskEvery;
    return tl::unexpected<Error>(reason_);
  }

  /// The same of a reading: the object may be missing while the bucket is there.
  template <class T>
  Result<T> OfObject(const std::string& name, Result<T> result) {
    if (result || result.error().code != ErrorCode::kNotFound) return Heard(std::move(result));
    const auto found = Heard(client_.Find(NameOf(name)));
    if (!found) return Forward(found);
    return *found ? Heard(std::move(result)) : std::move(result);
  }

  const S3Name prefix_;
  const std::unique_ptr<UploadJournal> journal_;
  S3Client client_, probe_;
  std::atomic<bool> away_{false};
  std::mutex mutex_;  // Guards all below.
  bool asking_ = false;
  Error reason_{ErrorCode::kIo, {}};
  SteadyClock::time_point heard_, ask_again_;
};

}  // namespace

Result<std::unique_ptr<ObjectPlace>> OpenBucketPlace(const S3Name& prefix, const S3Config& config,
                                                     const std::string& state) {
  auto journal = UploadJournal::Open(state + "/bucket-uploads");
  if (!journal) return Forward(journal);
  auto place = std::make_unique<BucketPlace>(prefix, config, *std::move(journal));
  place->AbortLeftovers();
  return place;
}

}  // namespace strata::server
