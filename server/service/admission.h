// Which jobs run now: as many as there are places and memory, the others in the order they came.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <list>
#include <mutex>

#include "server/service/problem.h"

namespace strata::server {

class Admission;

/// A job's place and memory, given back when it goes. Movable.
class Ticket {
 public:
  Ticket() = default;
  Ticket(Ticket&& other) noexcept;
  Ticket& operator=(Ticket&& other) noexcept;
  ~Ticket();

 private:
  friend class Admission;
  Ticket(Admission* admission, std::uint64_t bytes) : admission_(admission), bytes_(bytes) {}
  Admission* admission_ = nullptr;
  std::uint64_t bytes_ = 0;
};

/// Threads: any. Must outlive its tickets.
class Admission {
 public:
  struct Limits {
    std::uint32_t jobs = 2;          ///< That run at a time.
    std::uint32_t waiting = 256;     ///< Beyond them.
    std::uint64_t memory_bytes = 0;  ///< Of all that run.
  };
  /// How many jobs run and wait, and the bytes promised to those that run.
  using Watcher =
      std::function<void(std::uint64_t running, std::uint64_t waiting, std::uint64_t bytes)>;

  /// `changed` is called with the lock held whenever one of its figures has changed.
  Admission(const Limits& limits, Watcher changed)
      : limits_(limits), changed_(std::move(changed)) {}

  /// What happens where as many wait already as may: a client that asks now is told to come again;
  /// what was accepted before, and is kept in a queue of its own, waits all the same.
  enum class Full { kRefuse, kWait };

  /// Waits for a place and `bytes` of memory, first come, first served. Calls `gone` about 20 times
  /// a second; true ends the wait with kCancelled.
  /// Refuses: kUnavailable when as many wait already as may, and `full` says so; over-limit when
  /// `bytes` are more than there are in all.
  Answer<Ticket> Enter(std::uint64_t bytes, const std::function<bool()>& gone, Full full);

 private:
  friend class Ticket;
  void Leave(std::uint64_t bytes);
  void Tell() { changed_(running_, waiting_.size(), taken_); }

  const Limits limits_;
  const Watcher changed_;
  std::mutex mutex_;
  std::condition_variable moved_;
  std::list<std::uint64_t> waiting_;  // Their tickets' numbers, in order.
  std::uint64_t next_number_ = 0, running_ = 0, taken_ = 0;
};

}  // namespace strata::server
