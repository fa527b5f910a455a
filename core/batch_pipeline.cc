#include "core/batch_pipeline.h"

#include <tbb/concurrent_queue.h>
#include <tbb/parallel_pipeline.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <vector>

namespace strata {
namespace {

class Pipeline {
 public:
  Pipeline(MeshReader& reader, std::size_t batch_size, RunContext& context, const BatchWork& work)
      : reader_(reader), context_(context), work_(work) {
    tokens_ = 2 * static_cast<std::size_t>(tbb::this_task_arena::max_concurrency());
    for (std::size_t i = 0; i < tokens_; ++i) {
      batches_.push_back(std::make_unique<TriangleBatch>(batch_size));
      free_.push(batches_.back().get());
    }
  }

  Result<void> Run() {
    if (auto rewound = reader_.Rewind(); !rewound) return Forward(rewound);
    tbb::parallel_pipeline(
        tokens_, tbb::make_filter<void, TriangleBatch*>(
                     tbb::filter_mode::serial_in_order,
                     [&](tbb::flow_control& flow) { return Next(flow); }) &
                     tbb::make_filter<TriangleBatch*, void>(
                         tbb::filter_mode::parallel, [&](TriangleBatch* batch) { Work(*batch); }));
    if (context_.cancelled()) return Cancelled();
    if (failure_) return tl::unexpected<Error>(*failure_);
    return {};
  }

 private:
  TriangleBatch* Next(tbb::flow_control& flow) {
    TriangleBatch* batch = nullptr;
    if (failed_ || context_.cancelled() || !free_.try_pop(batch)) {
      flow.stop();
      return nullptr;
    }
    const auto count = reader_.Read(*batch);
    if (!count) Fail(count.error());
    if (!count || *count == 0) {
      flow.stop();
      return nullptr;
    }
    context_.SetProgress(reader_.bytes_read(), reader_.bytes_total().value_or(0));
    return batch;
  }

  void Work(TriangleBatch& batch) {
    if (!failed_ && !context_.cancelled()) {
      if (auto worked = work_(batch); !worked) Fail(worked.error());
    }
    free_.push(&batch);
  }

  // The first failure stands.
  void Fail(const Error& error) {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!failure_) failure_ = error;
    failed_ = true;
  }

  MeshReader& reader_;
  RunContext& context_;
  const BatchWork& work_;
  std::size_t tokens_;
  std::vector<std::unique_ptr<TriangleBatch>> batches_;
  tbb::concurrent_queue<TriangleBatch*> free_;
  std::atomic<bool> failed_{false};
  std::mutex mutex_;
  std::optional<Error> failure_;
};

}  // namespace

Result<void> ForEachBatch(MeshReader& reader, std::size_t batch_size, RunContext& context,
                          const BatchWork& work) {
  return Pipeline(reader, batch_size, context, work).Run();
}

}  // namespace strata
