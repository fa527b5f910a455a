// Ends calls whose client is too slow: gRPC's own reads wait for ever.
#pragma once

#include <grpcpp/server_context.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <list>
#include <mutex>
#include <thread>

namespace strata::server {

/// A thread that looks at every open transfer once a second. Threads: any.
class CallWatch {
 public:
  /// Transfers slower than this on average, beyond the first `grace`, are cancelled; likewise those
  /// whose next message of 1 MiB is slower.
  struct Rate {
    std::uint64_t bytes_per_second;
    std::chrono::seconds grace;
  };

  /// One direction of one call. While it lives, the call is watched.
  class Transfer {
   public:
    Transfer(CallWatch& watch, grpc::ServerContextBase& context);
    ~Transfer();
    Transfer(const Transfer&) = delete;
    Transfer& operator=(const Transfer&) = delete;

    void Add(std::uint64_t bytes) { bytes_ += bytes; }
    std::uint64_t bytes() const { return bytes_; }
    bool too_slow() const { return too_slow_; }
    bool cancelled() const { return context_.IsCancelled(); }

   private:
    friend class CallWatch;
    CallWatch& watch_;
    grpc::ServerContextBase& context_;
    const std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
    std::atomic<std::uint64_t> bytes_{0};
    std::atomic<bool> too_slow_{false};
    std::uint64_t seen_ = 0;  // Of bytes_, by the watch, which alone uses these two.
    std::chrono::steady_clock::time_point moved_ = start_;
    std::list<Transfer*>::iterator place_;
  };

  explicit CallWatch(const Rate& rate);
  ~CallWatch();
  const Rate& rate() const { return rate_; }

 private:
  void Look();
  bool IsTooSlow(Transfer& transfer) const;

  const Rate rate_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stopped_ = false;
  std::list<Transfer*> transfers_;
  std::thread thread_;
};

}  // namespace strata::server
