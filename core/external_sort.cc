#include "core/external_sort.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <string>
#include <string_view>

namespace strata {
namespace {

// A run is read in portions of at least so much.
constexpr std::uint64_t kLeastPortion = 4096;
constexpr std::uint64_t kMostPortion = std::uint64_t{1} << 18;

}  // namespace

ExternalSort::ExternalSort(std::size_t record_bytes, std::uint64_t memory_bytes, const char* what,
                           RunContext& context)
    : record_bytes_(record_bytes),
      most_records_(static_cast<std::size_t>(
          std::min<std::uint64_t>(memory_bytes / (record_bytes + sizeof(Place)),
                                  std::numeric_limits<std::uint32_t>::max()))),
      what_(what),
      context_(context) {}

Result<std::unique_ptr<ExternalSort>> ExternalSort::Open(std::size_t record_bytes,
                                                         std::uint64_t memory_bytes,
                                                         const char* what, RunContext& context) {
  std::unique_ptr<ExternalSort> sorter(new ExternalSort(record_bytes, memory_bytes, what, context));
  auto share = context.memory().Take(memory_bytes, what);
  if (!share) return Forward(share);
  sorter->share_ = std::move(*share);
  return sorter;
}

std::uint64_t ExternalSort::KeyAt(const char* record) const {
  std::uint64_t key;
  std::memcpy(&key, record, sizeof key);
  return key;
}

Result<void> ExternalSort::Add(const char* record) {
  if (order_.size() == most_records_) {
    if (auto spilled = Spill(); !spilled) return spilled;
  }
  // Space is reserved at once, as growing by copies would take more than was promised.
  if (records_.capacity() == 0) {
    records_.reserve(most_records_ * record_bytes_);
    order_.reserve(most_records_);
  }
  order_.push_back({KeyAt(record), static_cast<std::uint32_t>(order_.size())});
  records_.insert(records_.end(), record, record + record_bytes_);
  ++size_;
  return {};
}

void ExternalSort::SortInMemory() {
  std::sort(order_.begin(), order_.end(), [](const Place& a, const Place& b) {
    return a.key != b.key ? a.key < b.key : a.index < b.index;
  });
}

const char* ExternalSort::InMemory(std::size_t rank) const {
  return records_.data() + order_[rank].index * record_bytes_;
}

Result<void> ExternalSort::Spill() {
  if (context_.cancelled()) return Cancelled();
  if (context_.scratch() == nullptr) {
    return Fail(ErrorCode::kOverBudget,
                std::string(what_) + " need more than " + std::to_string(share_.bytes()) +
                    " bytes of the memory budget, and no scratch space was given");
  }
  if (file_ == nullptr) {
    auto file = context_.scratch()->NewFile();
    if (!file) return Forward(file);
    file_ = std::move(*file);
  }
  SortInMemory();
  Run run;
  run.next = file_->size();
  std::vector<char> portion;
  portion.reserve(kMostPortion + record_bytes_);
  for (std::size_t rank = 0; rank < order_.size(); ++rank) {
    const char* const record = InMemory(rank);
    portion.insert(portion.end(), record, record + record_bytes_);
    if (portion.size() < kMostPortion && rank + 1 < order_.size()) continue;
    if (auto written = file_->Append({portion.data(), portion.size()}); !written) return written;
    portion.clear();
  }
  run.end = file_->size();
  runs_.push_back(std::move(run));
  records_.clear();
  order_.clear();
  return {};
}

Result<bool> ExternalSort::Refill(Run& run) {
  const std::uint64_t n = std::min<std::uint64_t>(run.buffer.size(), run.end - run.next);
  run.at = 0;
  run.filled = static_cast<std::size_t>(n);
  if (n == 0) return false;
  if (auto read = file_->ReadAt(run.next, std::span<char>(run.buffer).first(run.filled)); !read) {
    return Forward(read);
  }
  run.next += n;
  return true;
}

// Equal keys lie in runs in the order in which the runs were made.
bool ExternalSort::IsAfter(std::uint32_t a, std::uint32_t b) const {
  const std::uint64_t x = KeyAt(runs_[a].buffer.data() + runs_[a].at);
  const std::uint64_t y = KeyAt(runs_[b].buffer.data() + runs_[b].at);
  return x != y ? x > y : a > b;
}

Result<void> ExternalSort::Sort() {
  if (runs_.empty()) {
    SortInMemory();
    return {};
  }
  if (!order_.empty()) {
    if (auto spilled = Spill(); !spilled) return spilled;
  }
  std::vector<char>().swap(records_);
  std::vector<Place>().swap(order_);
  const std::uint64_t portion =
      std::min(kMostPortion, share_.bytes() / runs_.size()) / record_bytes_ * record_bytes_;
  if (portion < kLeastPortion / 2) {
    return Fail(ErrorCode::kOverBudget, std::string(what_) + " need at least " +
                                            std::to_string(kLeastPortion * runs_.size()) +
                                            " bytes of the memory budget for sorting; " +
                                            std::to_string(share_.bytes()) + " are left");
  }
  for (std::uint32_t r = 0; r < runs_.size(); ++r) {
    runs_[r].buffer.resize(static_cast<std::size_t>(portion));
    const auto filled = Refill(runs_[r]);
    if (!filled) return Forward(filled);
    if (*filled) heap_.push_back(r);
  }
  std::make_heap(heap_.begin(), heap_.end(),
                 [this](std::uint32_t a, std::uint32_t b) { return IsAfter(a, b); });
  return {};
}

Result<const char*> ExternalSort::Next() {
  if (runs_.empty()) return rank_ == order_.size() ? nullptr : InMemory(rank_++);
  const auto after = [this](std::uint32_t a, std::uint32_t b) { return IsAfter(a, b); };
  // The run that gave the last record stands at the heap's end, one record behind.
  if (started_) {
    Run& run = runs_[heap_.back()];
    run.at += record_bytes_;
    if (run.at == run.filled) {
      const auto more = Refill(run);
      if (!more) return Forward(more);
      if (!*more) {
        std::vector<char>().swap(run.buffer);
        heap_.pop_back();
      } else {
        std::push_heap(heap_.begin(), heap_.end(), after);
      }
    } else {
      std::push_heap(heap_.begin(), heap_.end(), after);
    }
  }
  started_ = true;
  if (heap_.empty()) {
    started_ = false;
    return nullptr;
  }
  std::pop_heap(heap_.begin(), heap_.end(), after);
  const Run& run = runs_[heap_.back()];
  return run.buffer.data() + run.at;
}

}  // namespace strata
