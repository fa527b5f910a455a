#include "io/placed_reader.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace strata::io {
namespace {

// What a mirroring turns inside out is turned back: the second and third corner change places.
void Move(TriangleBatch& batch, std::size_t begin, std::size_t end, const Affine& transform) {
  const int swapped = transform.Determinant() < 0 ? 3 : 0;
  for (std::size_t i = begin; i < end; ++i) {
    const Vec3 a = transform(batch.corner(i, 0));
    const Vec3 b = transform(batch.corner(i, 1)), c = transform(batch.corner(i, 2));
    for (int axis = 0; axis < 3; ++axis) {
      batch.column(axis)[i] = a[axis];
      batch.column(3 + swapped + axis)[i] = b[axis];
      batch.column(6 - swapped + axis)[i] = c[axis];
    }
  }
}

}  // namespace

std::uint64_t PlacedReader::bytes_read() const {
  const std::uint64_t total = bytes_total().value_or(0);
  if (triangle_count_ == 0) return total;
  return static_cast<std::uint64_t>(static_cast<double>(total) * static_cast<double>(next_) /
                                    static_cast<double>(triangle_count_));
}

bool PlacedReader::SelectShare(const Share& share) {
  share_ = share;
  UpdateCounts();
  return true;
}

Result<void> PlacedReader::AddPlacement(const Placement& placement) {
  if (placement.count > (UINT64_MAX - triangle_count_) / placement.triangles) {
    return Fail(ErrorCode::kOverBudget, source_->name() + ": more than 2^64 triangles");
  }
  const std::uint64_t begin = triangle_count_;
  triangle_count_ += placement.triangles * placement.count;
  placements_.push_back({placement, begin, triangle_count_});
  return {};
}

PlacedReader::Location PlacedReader::Locate(std::uint64_t triangle) const {
  const auto behind = std::upper_bound(
      placements_.begin(), placements_.end(), triangle,
      [](std::uint64_t number, const Numbered& each) { return number < each.begin; });
  const Numbered& here = *std::prev(behind);
  const std::uint64_t within = triangle - here.begin;
  return {
      static_cast<std::size_t>(behind - placements_.begin()) - 1,
      here.placement.first_transform + static_cast<std::size_t>(within / here.placement.triangles),
      within % here.placement.triangles};
}

void PlacedReader::DropGeometry() {
  faces_ = FaceAssembler();
  geometry_.reset();
}

Result<std::size_t> PlacedReader::Read(TriangleBatch& batch) {
  batch.Clear();
  while (!batch.full()) {
    const auto more = Enter();
    if (!more) return Forward(more);
    if (!*more) break;
    const std::size_t before = batch.size();
    if (auto ok = ReadSome(batch); !ok) return Forward(ok);
    Place(batch, before);
  }
  UpdateCounts();
  return batch.size();
}

Result<void> PlacedReader::Rewind() {
  next_ = 0;
  at_ = 0;
  done_ = {};
  faces_ = FaceAssembler();
  if (loaded_ != 0) geometry_.reset();
  if (geometry_ != nullptr && geometry_->vertices().far() != nullptr) {
    geometry_->vertices().far()->Rewind();
  }
  if (geometry_ != nullptr) StartFaces();
  UpdateCounts();
  return {};
}

// Goes to the placement that holds the share's next triangle, and loads it; false at the end.
Result<bool> PlacedReader::Enter() {
  const std::uint64_t next = std::min(share_.Next(next_), triangle_count_);
  const std::uint64_t passed = next - std::exchange(next_, next);
  if (next_ == triangle_count_) return false;
  while (next_ >= placements_[at_].end) ++at_;
  if (geometry_ != nullptr && loaded_ == at_) {
    faces_.PassOver(passed);
    return true;
  }
  done_.Add(faces_.counts());
  faces_ = FaceAssembler();
  geometry_.reset();
  auto loaded = LoadGeometry(at_);
  if (!loaded) return Forward(loaded);
  geometry_ = std::move(*loaded);
  loaded_ = at_;
  StartFaces();
  return true;
}

void PlacedReader::StartFaces() {
  faces_.SetVertices(geometry_->vertices());
  faces_.PassOver(next_);
}

void PlacedReader::UpdateCounts() {
  counts_ = done_;
  counts_.Add(faces_.counts());
  counts_.vertices = share_.index == 0 ? vertex_count_ : 0;
}

Result<void> PlacedReader::ReadSome(TriangleBatch& batch) {
  FarVertices* const far = faces_.far();
  faces_.Continue(batch);
  if (far != nullptr && far->WantsLookAhead(faces_.counts().triangles)) {
    if (auto ok = LookAhead(*far); !ok) return ok;
  }
  auto filled = Fill(faces_);
  if (far != nullptr && far->failed()) return far->failure();
  return filled;
}

// Adds triangles of this placement until the batch is full.
Result<void> PlacedReader::Fill(FaceAssembler& faces) {
  const Numbered& here = placements_[at_];
  while (!faces.full()) {
    const std::uint64_t next = share_.Next(next_);
    if (next >= here.end) {
      next_ = here.end;
      return {};
    }
    faces.PassOver(next - std::exchange(next_, next));
    const auto corners = geometry_->Corners((next_ - here.begin) % here.placement.triangles);
    if (!corners) return Forward(corners);
    faces.AddFace(*corners);
    ++next_;
  }
  return {};
}

Result<void> PlacedReader::LookAhead(FarVertices& far) {
  const std::uint64_t next = next_;
  FaceAssembler scout = faces_.Scout();
  const auto go_on = [&]() -> Result<bool> {
    if (auto ok = Fill(scout); !ok) return Forward(ok);
    return next_ >= placements_[at_].end;
  };
  const auto go_back = [&]() -> Result<void> {
    next_ = next;
    return {};
  };
  return far.LookAhead(go_on, go_back);
}

// Puts the triangles from `begin` on where their placings are.
void PlacedReader::Place(TriangleBatch& batch, std::size_t begin) const {
  const Numbered& here = placements_[at_];
  const std::uint64_t* const ids = batch.ids();
  while (begin < batch.size()) {
    const std::uint64_t placing = (ids[begin] - here.begin) / here.placement.triangles;
    const std::uint64_t last = here.begin + (placing + 1) * here.placement.triangles;
    const auto end =
        static_cast<std::size_t>(std::lower_bound(ids + begin, ids + batch.size(), last) - ids);
    const Affine& transform =
        TransformOf(here.placement.first_transform + static_cast<std::size_t>(placing));
    if (!transform.is_identity()) Move(batch, begin, end, transform);
    begin = end;
  }
}

}  // namespace strata::io
