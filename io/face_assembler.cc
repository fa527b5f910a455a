#include "io/face_assembler.h"

#include <algorithm>
#include <utility>

#include "io/triangulate.h"

namespace strata::io {

void FaceAssembler::Restart() {
  counts_.faces = counts_.triangles = 0;
  counts_.skipped = {};
  passed_ = 0;
  pieces_.clear();
  next_piece_ = 0;
  strip_length_ = 0;
}

FaceAssembler FaceAssembler::Scout() const {
  FaceAssembler scout;
  scout.far_ = far_;
  scout.scouting_ = true;
  scout.counts_ = counts_;
  scout.vertex_count_ = vertex_count_;
  scout.passed_ = passed_;
  std::copy_n(strip_, 2, scout.strip_);
  scout.strip_length_ = strip_length_;
  return scout;
}

void FaceAssembler::Begin(TriangleBatch& batch) {
  batch_ = &batch;
  batch.Clear();
  Drain();
}

void FaceAssembler::AddFace(std::span<const std::int64_t> corners) {
  ++counts_.faces;
  const std::size_t n = corners.size();
  if (n < 3) return Skip(SkipReason::kTooFewCorners, 1);
  const auto in_range = [this](std::int64_t i) { return InRange(i); };
  if (!std::all_of(corners.begin(), corners.end(), in_range)) {
    return Skip(SkipReason::kIndexOutOfRange, n - 2);
  }
  if (n > 3) return AddPolygon(corners);
  AddTriangle(corners[0], corners[1], corners[2]);
}

void FaceAssembler::AddTriangle(std::int64_t a, std::int64_t b, std::int64_t c) {
  const std::uint64_t id = passed_ + counts_.triangles++;
  if (scouting_) {
    for (const std::int64_t i : {a, b, c}) far_->Record(static_cast<std::uint64_t>(i));
    return;
  }
  const Vec3 first = At(a), second = At(b), third = At(c);
  batch_->Push(first, second, third, id);
}

void FaceAssembler::AddStripCorner(std::int64_t index) {
  const std::int64_t first = std::exchange(strip_[0], strip_[1]);
  const std::int64_t second = std::exchange(strip_[1], index);
  if (++strip_length_ < 3) return;
  ++counts_.faces;
  if (!InRange(first) || !InRange(second) || !InRange(index)) {
    return Skip(SkipReason::kIndexOutOfRange, 1);
  }
  const bool turned = strip_length_ % 2 == 0;
  AddTriangle(turned ? second : first, turned ? first : second, index);
}

void FaceAssembler::EndStrip() {
  if (strip_length_ == 1 || strip_length_ == 2) {
    ++counts_.faces;
    Skip(SkipReason::kTooFewCorners, 1);
  }
  strip_length_ = 0;
}

void FaceAssembler::Skip(SkipReason reason, std::uint64_t numbers) {
  // Reasons count triangles, so that read = sampled + skipped.
  counts_.skipped[static_cast<std::size_t>(reason)] += numbers;
  counts_.triangles += numbers;
}

void FaceAssembler::AddPolygon(std::span<const std::int64_t> corners) {
  if (scouting_) {
    for (const std::int64_t i : corners) far_->Record(static_cast<std::uint64_t>(i));
    counts_.triangles += corners.size() - 2;
    return;
  }
  corners_.clear();
  for (const std::int64_t i : corners) corners_.push_back(At(i));
  pieces_.clear();
  next_piece_ = 0;
  TriangulatePolygon(corners_, pieces_);
  Drain();
}

void FaceAssembler::Drain() {
  for (; next_piece_ < pieces_.size() && !batch_->full(); ++next_piece_) {
    const auto& [a, b, c] = pieces_[next_piece_];
    batch_->Push(corners_[a], corners_[b], corners_[c], passed_ + counts_.triangles++);
  }
}

}  // namespace strata::io
