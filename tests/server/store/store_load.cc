#include "tests/server/store/store_load.h"

#include <unistd.h>

#include <mutex>
#include <random>
#include <set>
#include <thread>
#include <vector>

#include "io/sha256.h"

namespace strata::server {
namespace {

constexpr int kMaxEach = 3000;

std::string RandomBytes(std::size_t size, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::string bytes(size, 0);
  for (char& c : bytes) c = static_cast<char>(random());
  return bytes;
}

// One write, so that lines of threads do not mix and a kill leaves no half of them.
void Say(const std::string& line) {
  const std::string text = line + "\n";
  if (write(STDOUT_FILENO, text.data(), text.size()) < 0) _exit(3);
}

class Load {
 public:
  Load(Store& store, std::uint64_t round) : store_(store), round_(round) {}

  void MakeJobs(int who) {
    for (int i = 0; i < kMaxEach; ++i) {
      while (store_.jobs().queued() > 12) std::this_thread::yield();
      const std::string name =
          std::to_string(round_) + "." + std::to_string(who) + "." + std::to_string(i);
      const std::string hash = io::Sha256Hex(name);
      const auto made =
          store_.jobs().Create({"m", io::Sha256Hex("m"), name, hash, "load", "key " + name});
      if (!made) return Fail("Create", made.error());
      Say("job " + made->job.id + " " + name);
      if (i % 7 == 6 && store_.jobs().Cancel(made->job.id)->state == JobState::kCancelled) {
        Say("cancelled " + made->job.id);
      }
    }
  }

  void DoJobs() {
    for (int i = 0; i < kMaxEach; ++i) {
      store_.jobs().WaitForQueued(Milliseconds(100));
      auto claimed = store_.jobs().Claim("worker");
      if (!claimed) return Fail("Claim", claimed.error());
      if (*claimed) Do(**claimed);
    }
  }

  void Upload() {
    for (int i = 0; i < kMaxEach; ++i) {
      const std::uint64_t number = round_ * 10'000 + static_cast<std::uint64_t>(i);
      const std::string bytes = ContentOf(number), model = "u" + std::to_string(number);
      const auto made = store_.uploads().Create({model, bytes.size(), ""});
      if (!made) return Fail("Create", made.error());
      Say("upload " + made->id + " " + model + " " + std::to_string(number));
      for (std::uint64_t at = 0; at < bytes.size();) {
        const std::uint64_t part = std::min<std::uint64_t>(bytes.size() - at, 17'000);
        auto append = store_.uploads().Append(made->id, at);
        if (!append) return Fail("Append", append.error());
        for (std::uint64_t j = 0; j < part; j += 5'000) {
          if (!append->Write(bytes.substr(at + j, std::min<std::uint64_t>(5'000, part - j))))
            return;
        }
        if (auto sent = append->Finish(); !sent) return Fail("Finish", sent.error());
        at += part;
        Say("offset " + made->id + " " + std::to_string(at));
      }
      Say("model " + model + " " + std::to_string(number));
    }
  }

  void PutModels() {
    for (int i = 0; i < kMaxEach; ++i) {
      const std::uint64_t number = round_ * 10'000 + static_cast<std::uint64_t>(i);
      const std::string name = "p" + std::to_string(i % 3), text = std::to_string(number);
      Say("try " + name + " " + text);
      if (!Put(name, number)) return;
      Say("put " + name + " " + text);
      if (!Put("d" + text, number) || !store_.models().Delete("d" + text)) return;
      Say("gone d" + text);
    }
  }

 private:
  static void Fail(const std::string& what, const Error& error) {
    Say("failed " + what + ": " + error.message);
  }

  bool Put(const std::string& name, std::uint64_t number) {
    auto writer = store_.blobs().NewBlob(BlobKind::kModel);
    if (!writer || !writer->Write(ContentOf(number))) return false;
    const auto pin = writer->Commit();
    return pin && store_.models().Put(name, *pin);
  }

  void Do(const JobStore::Claimed& claimed) {
    const std::string& id = claimed.job.id;
    {
      const std::lock_guard lock(mutex_);
      if (!at_work_.insert(id).second) Say("twice " + id);
    }
    (void)store_.jobs().Heartbeat(claimed.claim, {"scan", 1, 2});
    auto answer = store_.results().Enter(claimed.job.request.result_key);
    auto writer = store_.blobs().NewBlob(BlobKind::kResult);
    if (answer && writer && writer->Write(ResultOf(claimed.job.request.options))) {
      const auto pin = writer->Commit();
      if (pin && answer->lead) (void)answer->lead->Publish(*pin, "text/plain", "summary");
      if (pin && store_.jobs().Succeed(claimed.claim, *pin, {"", 0, "text/plain", "summary"})) {
        Say("done " + id);
      }
    }
    const std::lock_guard lock(mutex_);
    at_work_.erase(id);
  }

  Store& store_;
  std::uint64_t round_;
  std::mutex mutex_;
  std::set<std::string> at_work_;
};

}  // namespace

StoreOptions LoadOptions(const std::string& data) {
  StoreOptions options;
  options.data = data;
  options.blobs.keep_free_bytes = 0;
  options.jobs.max_attempts = 0;  // It is the processes that die here, for no fault of the jobs.
  options.uploads.sync_bytes = 8'000;
  return options;
}

std::string ResultOf(const std::string& options) {
  const std::uint64_t seed = std::hash<std::string>()(options);
  return options + RandomBytes(10'000 + seed % 20'000, seed);
}

std::string ContentOf(std::uint64_t number) { return RandomBytes(30'000 + number % 7'000, number); }

int RunLoad(const std::string& data, std::uint64_t round) {
  const SystemClock clock;
  auto store = Store::Open(LoadOptions(data), clock);
  if (!store) {
    Say("failed Open: " + store.error().message);
    return 1;
  }
  Say("ready");
  Load load(**store, round);
  std::vector<std::thread> threads;
  threads.emplace_back([&] { load.MakeJobs(0); });
  threads.emplace_back([&] { load.MakeJobs(1); });
  threads.emplace_back([&] { load.DoJobs(); });
  threads.emplace_back([&] { load.DoJobs(); });
  threads.emplace_back([&] { load.Upload(); });
  threads.emplace_back([&] { load.PutModels(); });
  for (std::thread& thread : threads) thread.join();
  return 0;
}

}  // namespace strata::server
