// Where a job's parallel work runs.
#pragma once

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <cstddef>
#include <utility>

namespace strata {

/// Runs `work` on up to `threads` threads, this one included; 0 = all the processors this process
/// may use. Returns what it returns.
template <class F>
auto InArena(int threads, F&& work) {
  if (threads <= 0) threads = tbb::info::default_concurrency();
  // Without this, TBB would not start more workers than there are processors.
  const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                  static_cast<std::size_t>(threads));
  tbb::task_arena arena(threads);
  return arena.execute(std::forward<F>(work));
}

}  // namespace strata
