#include "io/vertex_store.h"

#include <algorithm>
#include <string>
#include <utility>

namespace strata::io {
namespace {

// Written to scratch space so much at a time.
constexpr std::uint64_t kSpillBytes = std::uint64_t{1} << 18;

std::uint64_t BudgetOf(const OpenOptions& options) {
  if (options.memory == nullptr || !options.memory->limited()) return options.vertex_budget;
  return std::min(options.vertex_budget, options.memory->left());
}

}  // namespace

VertexStore::VertexStore(std::string name, const OpenOptions& options)
    : name_(std::move(name)),
      options_(options),
      budget_(BudgetOf(options)),
      spill_at_(budget_),
      limited_(budget_ != MemoryAccount::kUnlimited) {}

bool VertexStore::TakeBudget() {
  if (options_.memory == nullptr) return true;
  auto share = options_.memory->Take(budget_, name_ + ": the vertices");
  if (!share) return Fail(share.error());
  share_ = std::move(*share);
  return true;
}

bool VertexStore::Spill() {
  if (options_.scratch == nullptr) {
    return Fail({ErrorCode::kOverBudget, name_ + ": the vertices need more than " +
                                             std::to_string(array_.bytes()) +
                                             " bytes, their budget is " + std::to_string(budget_) +
                                             "; no scratch space was given"});
  }
  if (spill_ == nullptr) {
    if (!TakeBudget()) return false;
    spill_ = std::make_unique<ScratchVertices>(*options_.scratch);
    spill_at_ = std::min(budget_, kSpillBytes);
  }
  spilled_ += array_.size();
  if (auto ok = spill_->Append(array_.view()); !ok) return Fail(ok.error());
  array_.Reset();
  return true;
}

bool VertexStore::Adopt(std::unique_ptr<VertexFile> file) {
  if (!TakeBudget()) return false;
  spilled_ = file->size();
  auto far = FarVertices::Open(std::move(file), budget_, options_, name_);
  if (!far) return Fail(far.error());
  far_ = std::move(*far);
  return true;
}

Result<void> VertexStore::Finish() {
  if (spill_ != nullptr) {
    if (array_.size() > 0 && !Spill()) return failure();
    auto far = FarVertices::Open(std::move(spill_), budget_, options_, name_);
    if (!far) return Forward(far);
    far_ = std::move(*far);
  } else if (far_ == nullptr && options_.memory != nullptr) {
    auto share = options_.memory->Take(array_.bytes(), name_ + ": the vertices");
    if (!share) return Forward(share);
    share_ = std::move(*share);
  }
  return {};
}

Result<bool> VertexStore::Visit(const std::function<void(const VertexView&)>& visit) const {
  if (far_ != nullptr) return far_->Visit(visit);
  if (array_.size() == 0) return false;
  visit(array_.view());
  return true;
}

}  // namespace strata::io
