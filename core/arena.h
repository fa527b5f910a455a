// Where a job's parallel work runs.
#pragma once

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <utility>

namespace strata {

/// What `threads` of a job may be at most.
inline constexpr std::size_t kMostThreads = 1024;

/// Lets TBB start more workers than there are processors. Once for the process, before its first
/// arena: of several limits the smallest holds for all, and TBB reads their list without its lock
/// while it makes an arena.
inline void AllowThreads() {
  static const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                         kMostThreads);
}

/// Runs `work` on up to `threads` threads, this one included; 0 = all the processors this process
/// may use. Returns what it returns. Threads: any; of several calls at a time each has its own.
template <class F>
auto InArena(int threads, F&& work) {
  AllowThreads();
  if (threads <= 0) threads = tbb::info::default_concurrency();
  tbb::task_arena arena(threads);
  return arena.execute(std::forward<F>(work));
}

}  // namespace strata
