// kill -9 at random moments: what was promised is kept, and nothing half is left.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <random>
#include <set>
#include <sstream>

#include "tests/server/store/store_fixture.h"
#include "tests/server/store/store_load.h"

namespace strata::server {
namespace {

// A process that runs RunLoad, and the lines it has said.
class LoadProcess {
 public:
  LoadProcess(const std::string& data, std::uint64_t round) {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) ADD_FAILURE() << "no pipe";
    const std::string number = std::to_string(round);
    id_ = fork();
    if (id_ == 0) {
      dup2(ends[1], STDOUT_FILENO);
      execl("/proc/self/exe", "load", "--load", data.c_str(), number.c_str(), nullptr);
      _exit(4);
    }
    close(ends[1]);
    out_ = ends[0];
  }
  ~LoadProcess() {
    Kill();
    close(out_);
  }

  /// Reads until `lines` have come, then for `more` longer. The bound is for a hanging process.
  void Listen(std::size_t lines, std::chrono::microseconds more) {
    const auto now = [] { return std::chrono::steady_clock::now(); };
    const auto bound = now() + std::chrono::seconds(60);
    while (Lines() < lines && now() < bound && Read(bound - now())) {
    }
    EXPECT_GE(Lines(), lines) << text_;
    const auto end = now() + more;
    while (now() < end && Read(end - now())) {
    }
  }
  /// What it said until it died.
  std::string KillAndHear() {
    Kill();
    while (Read(std::chrono::seconds(10))) {
    }
    return text_;
  }

 private:
  std::size_t Lines() const {
    return static_cast<std::size_t>(std::count(text_.begin(), text_.end(), '\n'));
  }
  // False at the end or when nothing came in time.
  bool Read(std::chrono::nanoseconds timeout) {
    pollfd ready{out_, POLLIN, 0};
    const timespec wait{timeout.count() / 1'000'000'000, timeout.count() % 1'000'000'000};
    if (ppoll(&ready, 1, &wait, nullptr) <= 0) return false;
    char bytes[4096];
    const ssize_t n = read(out_, bytes, sizeof bytes);
    if (n > 0) text_.append(bytes, static_cast<std::size_t>(n));
    return n > 0;
  }
  void Kill() {
    if (id_ <= 0) return;
    kill(id_, SIGKILL);
    waitpid(id_, nullptr, 0);
    id_ = -1;
  }

  pid_t id_ = -1;
  int out_ = -1;
  std::string text_;
};

// What the killed processes were promised, all rounds together.
struct Promises {
  std::map<std::string, std::string> jobs;  // Id -> options.
  std::map<std::string, JobState> ended;
  struct Upload {
    std::string model;
    std::uint64_t number = 0, offset = 0;
  };
  std::map<std::string, Upload> uploads;
  std::map<std::string, std::uint64_t> models;
  std::map<std::string, std::set<std::uint64_t>> tried;  // Since the last put, of all rounds.
  std::set<std::string> gone;

  void Hear(const std::string& text) {
    std::istringstream lines(text.substr(0, text.rfind('\n') + 1));
    for (std::string line; std::getline(lines, line);) HearLine(line);
  }
  void HearLine(const std::string& line) {
    std::istringstream words(line);
    std::string what, name;
    words >> what >> name;
    if (what == "job") words >> jobs[name];
    if (what == "done") ended[name] = JobState::kSucceeded;
    if (what == "cancelled") ended[name] = JobState::kCancelled;
    if (what == "upload") words >> uploads[name].model >> uploads[name].number;
    if (what == "offset") words >> uploads[name].offset;
    if (what == "model" || what == "put") words >> models[name];
    if (what == "put") tried[name].clear();
    if (what == "try") {
      std::uint64_t number = 0;
      words >> number;
      tried[name].insert(number);
    }
    if (what == "gone") gone.insert(name);
    EXPECT_NE(what, "twice") << line;
    EXPECT_NE(what, "failed") << line;
  }
};

class StoreCrashTest : public StoreTest {
 protected:
  void SetUp() override { options = LoadOptions(folder / "data"); }

  void CheckFiles() {
    EXPECT_EQ(Files("incoming"), std::vector<std::string>{});
    std::vector<std::string> known, unfinished;
    ASSERT_OK(store->database().Read().Query("SELECT hash FROM blobs", [&](const Row& row) {
      known.push_back(BlobStore::PathOf(row.Text(0)));
    }));
    ASSERT_OK(store->database().Read().Query(
        "SELECT id FROM uploads WHERE hash IS NULL",
        [&](const Row& row) { unfinished.push_back("uploads/" + row.Text(0)); }));
    std::sort(known.begin(), known.end());
    std::sort(unfinished.begin(), unfinished.end());
    EXPECT_EQ(Files("blobs"), known);
    EXPECT_EQ(Files("uploads"), unfinished);
    for (const std::string& path : known) {
      EXPECT_EQ(BlobStore::PathOf(HashOf(test::ReadFile(options.data + "/" + path))), path);
    }
    EXPECT_TRUE(store->blobs().recovery().damaged.empty());
  }

  void CheckJob(const std::string& id, const std::string& job_options,
                const std::map<std::string, JobState>& ended) {
    const auto job = store->jobs().Get(id);
    ASSERT_OK(job);
    EXPECT_NE(job->state, JobState::kRunning);
    EXPECT_NE(job->state, JobState::kFailed);
    const auto end = ended.find(id);
    EXPECT_TRUE(end == ended.end() || job->state == end->second) << id;
    if (job->state != JobState::kSucceeded) return;
    ASSERT_TRUE(job->result);
    const auto reader = store->blobs().OpenBlob(job->result->hash);
    ASSERT_OK(reader);
    EXPECT_EQ(job->result->hash, HashOf(ResultOf(job_options)));
    EXPECT_EQ(reader->size(), ResultOf(job_options).size());
  }

  void CheckModels(const Promises& promises) {
    for (const auto& [name, number] : promises.models) {
      const std::string found = ReadModel(name);
      const auto tried = promises.tried.find(name);
      const bool latest = found == ContentOf(number);
      const bool begun = tried != promises.tried.end() &&
                         std::ranges::any_of(tried->second, [&](std::uint64_t begun_number) {
                           return found == ContentOf(begun_number);
                         });
      EXPECT_TRUE(latest || begun) << name << " " << number << " " << found.substr(0, 80);
    }
    for (const std::string& name : promises.gone) {
      EXPECT_FAILS(ErrorCode::kNotFound, store->models().Get(name));
    }
  }

  void CheckUploads(const Promises& promises) {
    for (const auto& [id, upload] : promises.uploads) {
      const auto info = store->uploads().Head(id);
      ASSERT_OK(info);
      EXPECT_GE(info->offset, upload.offset);
      const std::string bytes = ContentOf(upload.number);
      if (info->hash.empty()) {
        EXPECT_EQ(test::ReadFile(options.data + "/uploads/" + id), bytes.substr(0, info->offset));
      } else {
        EXPECT_EQ(ReadModel(upload.model), bytes);
      }
    }
  }

  void Check(const Promises& promises) {
    CheckFiles();
    for (const auto& [id, job_options] : promises.jobs) CheckJob(id, job_options, promises.ended);
    CheckModels(promises);
    CheckUploads(promises);
    EXPECT_EQ(store->jobs().running(), 0u);
  }

  // Resumes every upload and does every job that is left.
  void FinishAll(const Promises& promises) {
    for (const auto& [id, upload] : promises.uploads) {
      const auto info = store->uploads().Head(id);
      if (!info->hash.empty()) continue;
      auto append = store->uploads().Append(id, info->offset);
      ASSERT_OK(append);
      ASSERT_OK(append->Write(ContentOf(upload.number).substr(info->offset)));
      ASSERT_OK(append->Finish());
      EXPECT_EQ(ReadModel(upload.model), ContentOf(upload.number));
    }
    for (;;) {
      const auto claimed = store->jobs().Claim("last");
      ASSERT_OK(claimed);
      if (!*claimed) break;
      const auto pin = NewBlob(ResultOf((*claimed)->job.request.options), BlobKind::kResult);
      ASSERT_OK(pin);
      ASSERT_OK(store->jobs().Succeed((*claimed)->claim, *pin, {}));
    }
  }
};

TEST_F(StoreCrashTest, KilledAtTwentyRandomMomentsItLosesNothingAndLeavesNothingHalf) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::cout << "seed " << seed << "\n";
  std::mt19937_64 random(seed);
  Promises promises;
  for (std::uint64_t round = 1; round <= 20; ++round) {
    SCOPED_TRACE("round " + std::to_string(round));
    LoadProcess load(options.data, round);
    load.Listen(random() % 40, std::chrono::microseconds(random() % 60'000));
    promises.Hear(load.KillAndHear());
    Open();
    if (store == nullptr) return;
    Check(promises);
    store.reset();
    if (HasFailure()) return;
  }
  Open();
  FinishAll(promises);
  std::size_t succeeded = 0;
  for (const auto& [id, job_options] : promises.jobs) {
    const auto job = store->jobs().Get(id);
    ASSERT_OK(job);
    EXPECT_TRUE(job->state == JobState::kSucceeded || job->state == JobState::kCancelled);
    if (job->state == JobState::kSucceeded) ++succeeded;
  }
  CheckFiles();
  std::cout << promises.jobs.size() << " jobs, " << succeeded << " succeeded, "
            << promises.ended.size() << " ended before a kill; " << promises.uploads.size()
            << " uploads; " << promises.gone.size() << " models put and deleted\n";
  EXPECT_GT(promises.jobs.size(), 20u) << "the load was none";
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  if (argc == 4 && std::string(argv[1]) == "--load") {
    return strata::server::RunLoad(argv[2], std::stoull(argv[3]));
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
