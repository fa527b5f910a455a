#include "server/service/worker.h"

#include <google/protobuf/io/zero_copy_stream_impl.h>
#include <google/protobuf/io/zero_copy_stream_impl_lite.h>
#include <google/protobuf/util/delimited_message_util.h>
#include <linux/close_range.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <exception>
#include <fstream>
#include <mutex>
#include <new>
#include <string>
#include <thread>

#include "io/output_place.h"
#include "server/service/job.h"
#include "server/service/worker_files.h"

namespace strata::server {
namespace {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define STRATA_SHADOW_MEMORY 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define STRATA_SHADOW_MEMORY 1
#endif
#endif
#ifdef STRATA_SHADOW_MEMORY
constexpr bool kShadowMemory = true;  // A sanitizer's terabytes of it count as the process's own.
#else
constexpr bool kShadowMemory = false;
#endif

constexpr std::chrono::milliseconds kReportEvery{100};

void Send(const internal::WorkerEvent& event) {
  std::string bytes;
  {
    google::protobuf::io::StringOutputStream stream(&bytes);
    google::protobuf::util::SerializeDelimitedToZeroCopyStream(event, &stream);
  }
  std::uint64_t written = 0;
  static_cast<void>(io::WriteAll(1, bytes, written));  // Without a listener there is no job either.
}

/// While it lives, sends progress whenever there is some.
class Reporter {
 public:
  explicit Reporter(const RunContext& context) : context_(context), thread_([this] { Report(); }) {}
  ~Reporter() {
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    wake_.notify_one();
    thread_.join();
  }
  Reporter(const Reporter&) = delete;
  Reporter& operator=(const Reporter&) = delete;

 private:
  void Report() {
    std::string last;
    std::unique_lock lock(mutex_);
    while (!wake_.wait_for(lock, kReportEvery, [this] { return stopped_; })) {
      internal::WorkerEvent event;
      *event.mutable_progress() = ProgressOf(context_);
      if (std::string now = event.SerializeAsString(); now != last) {
        Send(event);
        last = std::move(now);
      }
    }
  }

  const RunContext& context_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stopped_ = false;
  std::thread thread_;
};

/// The soft limit: the next job's may be higher.
void Limit(decltype(RLIMIT_CORE) resource, std::uint64_t amount) {
  rlimit limit{};
  if (getrlimit(resource, &limit) != 0) return;
  limit.rlim_cur = std::min<std::uint64_t>(amount, limit.rlim_max);
  static_cast<void>(setrlimit(resource, &limit));
}

std::uint64_t ProcessorSeconds() {
  rusage used{};
  static_cast<void>(getrusage(RUSAGE_SELF, &used));
  return static_cast<std::uint64_t>(used.ru_utime.tv_sec + used.ru_stime.tv_sec);
}

std::uint64_t DataBytes() {
  std::ifstream status("/proc/self/status");
  for (std::string word; status >> word;) {
    std::uint64_t kib = 0;
    if (word == "VmData:" && status >> kib) return kib * 1024;
  }
  return 0;
}

/// Address space would be the wrong measure: allocators and thread stacks reserve far more than
/// they touch. RLIMIT_DATA counts private memory that can be written, so reserved arenas are free
/// and one huge allocation fails at once. Beyond the budget: a quarter for what an allocator keeps,
/// stacks, and 64 MiB for libraries.
void LimitMemory(const internal::WorkerJob& job) {
  if (kShadowMemory) return;
  constexpr std::uint64_t kMiB = std::uint64_t{1} << 20;
  const std::uint64_t stacks = (job.threads() + 4) * 9 * kMiB;
  Limit(RLIMIT_DATA,
        DataBytes() + job.memory_bytes() + job.memory_bytes() / 4 + stacks + 64 * kMiB);
}

void LimitSelf(const internal::WorkerJob& job) {
  Limit(RLIMIT_CORE, 0);
  Limit(RLIMIT_CPU, ProcessorSeconds() + std::uint64_t{job.seconds()} * (job.threads() + 1) + 1);
  LimitMemory(job);
}

Result<v1::SampleSummary> RunGuarded(const internal::WorkerJob& job,
                                     std::shared_ptr<const io::CompanionFiles> companions) {
  try {
    RunContext context(job.memory_bytes());
    const Reporter reporter(context);
    return RunJob(job, kWorkerMesh, kWorkerResult, context, std::move(companions));
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget,
                "out of memory; the job may use " + std::to_string(job.memory_bytes()) + " bytes");
  } catch (const std::exception& error) {
    return Fail(ErrorCode::kInternal, std::string("unexpected: ") + error.what());
  }
}

/// Whether the parent has ended before it could be asked to signal its end: then nobody reads the
/// events.
bool ParentIsGone() {
  pollfd events = {1, 0, 0};
  return poll(&events, 1, 0) > 0 && (events.revents & (POLLERR | POLLHUP)) != 0;
}

internal::WorkerEvent RunReported(const internal::WorkerJob& job) {
  JobFiles files(job);
  internal::WorkerEvent last;
  const auto outcome = files.Begin() ? RunGuarded(job, files.companions()) : v1::SampleSummary();
  if (auto ended = files.End(outcome, *last.mutable_figures()); !ended) {
    last.mutable_failed()->set_code(static_cast<std::uint32_t>(ended.error().code));
    last.mutable_failed()->set_message(ended.error().message);
  } else {
    *last.mutable_done() = *outcome;
  }
  return last;
}

}  // namespace

int RunWorker() {
  // Sockets and files of the parent that were opened without close-on-exec.
  static_cast<void>(syscall(SYS_close_range, kWorkerResult + 1, ~0u, 0));
  static_cast<void>(prctl(PR_SET_PDEATHSIG, SIGKILL));
  if (ParentIsGone()) return 2;
  google::protobuf::io::FileInputStream jobs(0);
  while (true) {
    internal::WorkerJob job;
    bool no_more = false;
    if (!google::protobuf::util::ParseDelimitedFromZeroCopyStream(&job, &jobs, &no_more)) {
      return no_more ? 0 : 2;
    }
    LimitSelf(job);
    Send(RunReported(job));
  }
}

}  // namespace strata::server
