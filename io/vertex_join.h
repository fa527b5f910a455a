// Resolving many indices into vertices on disk without random access to the disk.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/result.h"
#include "core/run_context.h"
#include "core/scratch.h"
#include "io/vertex_array.h"
#include "io/vertex_file.h"

namespace strata::io {

/// An external join of a sequence of indices with the vertices they name. The vertices are divided
/// into parts that fit the budget.
///
/// 1. BeginRecord, then Record for every index: it is appended to the questions of its part.
/// 2. Resolve: part by part, the part is loaded and its questions are answered, in order.
/// 3. Next for the same indices in the same order: each takes the next answer of its part.
///
/// So neither questions nor answers need to say where they belong: the sequence itself, which the
/// caller reads twice, does. A small cache of vertices, which goes through the same states both
/// times, keeps what neighbouring triangles share from being asked again: where only the vertices'
/// order is random, it saves five questions of six. Scratch space: 4 bytes per question and the
/// vertex's 12 or 24, used again by the next round. Failures are kept: after one, what Next returns
/// is of no use. Threads: one at a time. Throws std::bad_alloc.
class VertexJoin {
 public:
  /// Whether `budget` bytes are enough: about the square root of 2 KiB times the vertices' bytes.
  static bool Fits(const VertexFile& file, std::uint64_t budget);

  /// Precondition: Fits(file, budget). `file` and `scratch` must outlive the join. Memory: at most
  /// `budget`, besides 8 bytes per block of questions.
  VertexJoin(VertexFile& file, ScratchFolder& scratch, std::uint64_t budget);

  Result<void> BeginRecord();
  void Record(std::uint64_t index) {
    ++recorded_;
    if (std::exchange(known_[SlotOf(index)], index) == index) return;
    Stream& stream = streams_[index >> shift_];
    *reinterpret_cast<std::uint32_t*>(stream.at) = static_cast<std::uint32_t>(index & mask_);
    stream.at += sizeof(std::uint32_t);
    ++asked_;
    if (stream.at == stream.end) [[unlikely]]
      FlushQuestions(index >> shift_);
  }
  /// `context`, if given, is polled. Errors: kIo, kCancelled.
  Result<void> Resolve(const RunContext* context);
  /// The vertex's coordinates in the file's precision, valid until the next call.
  const char* Next(std::uint64_t index) {
    ++taken_;
    const std::size_t slot = SlotOf(index);
    char* const vertex = positions_.data() + slot * vertex_bytes_;
    if (std::exchange(known_[slot], index) == index) return vertex;
    Stream& stream = streams_[index >> shift_];
    if (stream.at == stream.end) [[unlikely]]
      RefillAnswers(index >> shift_);
    vertex_bytes_ == 12 ? std::memcpy(vertex, stream.at, 12) : std::memcpy(vertex, stream.at, 24);
    stream.at += vertex_bytes_;
    return vertex;
  }

  /// Indices recorded since BeginRecord, and those of them that had to be asked.
  const std::uint64_t& recorded() const { return recorded_; }
  std::uint64_t asked() const { return asked_; }
  /// Indices answered since Resolve.
  const std::uint64_t& taken() const { return taken_; }
  bool failed() const { return failure_.has_value(); }
  tl::unexpected<Error> failure() const { return tl::unexpected<Error>(*failure_); }

 private:
  // A part's questions while recording, its answers while they are taken.
  struct Stream {
    char *begin = nullptr, *at = nullptr, *end = nullptr;
    std::vector<std::uint64_t> blocks;          // Full blocks of questions: which.
    std::uint64_t next_byte = 0, end_byte = 0;  // Answers not yet in view.
  };
  struct Plan {
    int shift, slot_bits;
    std::size_t question_bytes, answer_bytes;  // Of each part's buffer.
  };
  class Answers;

  static std::optional<Plan> PlanFor(const VertexFile& file, std::uint64_t budget);
  void Fail(Error error) {
    if (!failure_) failure_ = std::move(error);
  }
  void FlushQuestions(std::size_t part);
  void RefillAnswers(std::size_t part);
  Result<void> ResolvePart(std::size_t part, Answers& answers, const RunContext* context);
  void LayOut(std::size_t bytes_each);
  std::size_t SlotOf(std::uint64_t index) const {
    // Fibonacci hashing: the high bits of a product depend on all of the index.
    return static_cast<std::size_t>(index * 0x9e3779b97f4a7c15u >> slot_shift_);
  }
  void Forget() { std::fill(known_.begin(), known_.end(), ~std::uint64_t{0}); }

  VertexFile& file_;
  ScratchFolder& scratch_;
  Plan plan_;
  std::size_t vertex_bytes_;
  int shift_, slot_shift_;
  std::uint64_t mask_;
  std::vector<Stream> streams_;
  std::vector<std::uint64_t> known_;  // The cache: which vertex is in a slot,
  std::vector<char> positions_;       // and where it is.
  GrowArray<char> buffers_, part_;
  std::unique_ptr<ScratchFile> questions_, answers_;
  std::uint64_t blocks_ = 0, recorded_ = 0, asked_ = 0, taken_ = 0;
  std::optional<Error> failure_;
};

}  // namespace strata::io
