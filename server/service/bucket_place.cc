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
constexpr std::uint64_t kMostProbeBytes = 4096;

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
  Result<bool> PutTextIfNew(const std::string& name, std::string_view text) override {
    if (auto open = Gate(); !open) return Forward(open);
    return Heard(client_.PutNew(NameOf(name), text));
  }
  Result<std::optional<Version>> FindVersion(const std::string& name) override {
    if (auto open = Gate(); !open) return Forward(open);
    const auto found = OfObject([&] { return client_.Find(NameOf(name)); });
    if (!found) return Forward(found);
    if (*found) return std::optional(Version{(*found)->size, (*found)->etag});
    // Of a bucket that is not there HEAD says the same as of a missing object.
    if (name != kProbe) {
      if (auto asked = AskForMark(); !asked) return Forward(asked);
    }
    return std::optional<Version>();
  }
  Result<void> Fetch(const std::string& name, int fd, std::uint64_t max_bytes) override {
    if (auto open = Gate(); !open) return open;
    return AsVoid(OfObject([&] { return client_.GetToFile(NameOf(name), fd, max_bytes); }));
  }
  Result<void> Read(const std::string& name, std::uint64_t offset, std::span<char> out,
                    const std::string& tag) override {
    if (auto open = Gate(); !open) return open;
    return OfObject([&] { return client_.ReadAt(NameOf(name), offset, out, tag); });
  }
  Result<void> Delete(const std::string& name) override {
    if (auto open = Gate(); !open) return open;
    return OfObject([&] { return client_.Delete(NameOf(name)); });
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
    return away_ ? Gate() : AskForMark();
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
    auto asked = AskForMark();
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

  /// Reads the mark. With GET, which is what blobs are read with: HEAD is answered also where all
  /// content is refused (an archive's storage class, a key to it that is disabled), and a bucket
  /// that came back by the one and went by the other would do so for ever.
  Result<void> AskForMark() {
    const auto mark = probe_.Get(NameOf(kProbe), kMostProbeBytes);
    // Another content than the mark's is an answer as well.
    const bool answered = mark || mark.error().code == ErrorCode::kOverBudget;
    return Heard(answered ? Result<void>() : AsVoid(mark));
  }

  /// Whether a failure is none of the bucket's.
  static bool IsOurs(const Error& error) {
    return error.code == ErrorCode::kCancelled || error.code == ErrorCode::kOverBudget ||
           error.kind == &kLocalFile;
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
    if (IsOurs(result.error())) return result;
    reason_ = FailBucketAway(result.error().message).value();
    away_ = true;
    ask_again_ = SteadyClock::now() + kAskEvery;
    return tl::unexpected<Error>(reason_);
  }

  /// The same of what concerns one object. A refusal may be one of everything (keys, a policy, no
  /// bucket), or of this object: whether the mark can be read tells. Where the store could not, for
  /// now, it is asked once more, so that others were read before and after: one that begins to
  /// answer again in between is no refusal.
  template <class Ask>
  auto OfObject(const Ask& ask) -> decltype(ask()) {
    for (bool again = true;; again = false) {
      auto result = ask();
      if (result || IsOurs(result.error()) || result.error().kind == &kNoAnswer) {
        return Heard(std::move(result));
      }
      if (auto mark = AskForMark(); !mark) return Forward(mark);
      if (result.error().kind == &kStoreBusy && again) continue;
      // Another version than was asked for is none of the bucket's faults.
      if (result.error().code == ErrorCode::kConflict) return result;
      return FailObjectRefused(result.error().message + "; the bucket answers for others");
    }
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
