#include "io/far_vertices.h"

#include <algorithm>
#include <new>
#include <utility>
#include <vector>

namespace strata::io {
namespace {

constexpr std::uint64_t kNever = std::numeric_limits<std::uint64_t>::max();

// What a page costs besides its bytes, in bytes; and the bytes a window may load per triangle
// before joining is cheaper, which writes and reads some 50 each.
constexpr std::uint64_t kPageCost = 4096;
constexpr std::uint64_t kWorthPerTriangle = 256;
// A window may be filled this often in vain.
constexpr std::uint64_t kPatience = 2;
constexpr std::uint64_t kWindowRoom = 2048;

// Questions of a segment: enough that sweeping all vertices once for it is little beside the rest,
// few enough to bound scratch space.
constexpr std::uint64_t kQuestionsPerVertex = 2;
constexpr std::uint64_t kLeastSegment = std::uint64_t{1} << 14;
constexpr std::uint64_t kPoll = std::uint64_t{1} << 20;

tl::unexpected<Error> OutOfMemory() {
  return Fail(ErrorCode::kOverBudget, "the part of the vertices in use does not fit into memory");
}

}  // namespace

Result<std::unique_ptr<FarVertices>> FarVertices::Open(std::unique_ptr<VertexFile> file,
                                                       std::uint64_t budget,
                                                       const OpenOptions& options,
                                                       const std::string& name) {
  const std::uint64_t least = VertexWindow::LeastBudget(*file);
  if (budget < least) {
    return Fail(ErrorCode::kOverBudget, name + ": a window over the vertices needs " +
                                            std::to_string(least) + " bytes, its budget is " +
                                            std::to_string(budget));
  }
  return std::unique_ptr<FarVertices>(new FarVertices(std::move(file), budget, options));
}

FarVertices::FarVertices(std::unique_ptr<VertexFile> file, std::uint64_t budget,
                         const OpenOptions& options)
    : file_(std::move(file)),
      file_is_double_(file_->is_double()),
      budget_(budget),
      scratch_(options.scratch),
      context_(options.context),
      window_(std::make_unique<VertexWindow>(*file_, budget)),
      progress_(&window_->faults()),
      border_(kNever) {}

bool FarVertices::MayJoin() const {
  return scratch_ != nullptr && VertexJoin::Fits(*file_, budget_);
}

std::uint64_t FarVertices::Room() const {
  switch (mode_) {
    case Mode::kWindow:
      return kWindowRoom;
    case Mode::kRecord:
      return (border_ - *progress_) / 3 + 1;
    default:
      return (join_->recorded() - join_->taken()) / 3;
  }
}

// Whether what was loaded exceeds what triangles are worth by more than filling the window. Loads
// raise a debt, triangles pay it off, so that it forgets: a mesh may be coherent in parts only.
bool FarVertices::Thrashes(std::uint64_t triangles) {
  const std::uint64_t page = window_->page_bytes() + kPageCost;
  debt_ += (window_->faults() - faults_seen_) * page;
  debt_ -= std::min(debt_, (triangles - triangles_seen_) * kWorthPerTriangle);
  faults_seen_ = window_->faults();
  triangles_seen_ = triangles;
  border_ = faults_seen_ + kPatience * window_->bytes() / page + 1;
  return debt_ > kPatience * window_->bytes();
}

bool FarVertices::WantsLookAhead(std::uint64_t triangles) {
  if (mode_ != Mode::kWindow) return AtBorder();
  return MayJoin() && Thrashes(triangles);
}

Result<void> FarVertices::LookAhead(const std::function<Result<bool>()>& go_on,
                                    const std::function<Result<void>()>& go_back) {
  try {
    if (window_) faults_ += window_->faults();
    window_.reset();
    if (!join_) join_ = std::make_unique<VertexJoin>(*file_, *scratch_, budget_);
    if (auto ok = join_->BeginRecord(); !ok) return ok;
    mode_ = Mode::kRecord;
    progress_ = &join_->recorded();
    const auto ended = Record(go_on);
    if (!ended) return Forward(ended);
    if (auto ok = join_->Resolve(context_); !ok) return ok;
    mode_ = Mode::kReplay;
    progress_ = &join_->taken();
    border_ = *ended ? kNever : join_->recorded();
    ++segments_;
  } catch (const std::bad_alloc&) {
    return OutOfMemory();
  }
  return go_back();
}

Result<bool> FarVertices::Record(const std::function<Result<bool>()>& go_on) {
  const std::uint64_t segment = std::max(kLeastSegment, kQuestionsPerVertex * file_->size());
  bool ended = false;
  while (!ended && join_->asked() < segment) {
    if (context_ != nullptr && context_->cancelled()) return Cancelled();
    border_ = join_->recorded() + std::clamp(segment - join_->asked(), kLeastSegment / 4, kPoll);
    const auto at_end = go_on();
    ended = !at_end || *at_end;
    if (join_->failed()) return join_->failure();
  }
  return ended;
}

void FarVertices::Rewind() {
  triangles_seen_ = 0;
  if (mode_ != Mode::kWindow) border_ = 0;
}

Result<bool> FarVertices::Visit(const std::function<void(const VertexView&)>& visit) {
  const std::size_t bytes = file_->vertex_bytes();
  const std::uint64_t at_once = std::clamp<std::uint64_t>(budget_ / 16 / bytes, 16, 4096);
  std::vector<double> buffer(static_cast<std::size_t>(at_once) * 3);
  for (std::uint64_t first = 0; first < size();) {
    if (context_ != nullptr && context_->cancelled()) return Cancelled();
    const auto n = static_cast<std::size_t>(std::min(at_once, size() - first));
    char* const to = reinterpret_cast<char*>(buffer.data());
    if (auto ok = file_->Load(first, {to, n * bytes}); !ok) return Forward(ok);
    VertexView view;
    if (file_is_double_) {
      view.f64 = std::span<const double>(buffer).first(3 * n);
    } else {
      view.f32 = {reinterpret_cast<const float*>(to), 3 * n};
    }
    visit(view);
    first += n;
  }
  return true;
}

}  // namespace strata::io
