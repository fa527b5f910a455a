#include "io/vertex_join.h"

#include <algorithm>
#include <cstring>
#include <span>
#include <string_view>
#include <utility>

namespace strata::io {
namespace {

// Buffers smaller than this would make a system call for a handful of numbers.
constexpr std::size_t kLeastBuffer = 512;
constexpr std::size_t kMostBuffer = std::size_t{1} << 18;
// A part that fits the processor's cache answers faster, as long as parts do not become too many.
constexpr std::uint64_t kHandyPart = std::uint64_t{2} << 20;
constexpr std::uint64_t kHandyParts = 128;
constexpr int kSmallestShift = 6, kLargestShift = 31;
// Slots of the cache: enough for two rows of a grid of some 10^9 triangles.
constexpr int kLeastSlotBits = 4, kMostSlotBits = 18;

std::uint64_t PartsOf(const VertexFile& file, int shift) { return (file.size() >> shift) + 1; }

// The buffer's size when `parts` of them share `bytes`: a multiple of what both questions and
// vertices are multiples of.
std::size_t BufferBytes(std::uint64_t bytes, std::uint64_t parts, std::size_t multiple) {
  const std::uint64_t each = std::min<std::uint64_t>(bytes / parts, kMostBuffer);
  return static_cast<std::size_t>(each / multiple * multiple);
}

}  // namespace

// Half of the budget for the part that is loaded, a quarter for the questions' buffers, an eighth
// for the cache, and an eighth for a block of questions being answered and a block of answers.
// Later on, the answers' buffers have the room of the part.
std::optional<VertexJoin::Plan> VertexJoin::PlanFor(const VertexFile& file, std::uint64_t budget) {
  const std::uint64_t vertex = file.vertex_bytes();
  int shift = kLargestShift;
  while (shift > kSmallestShift && (vertex << shift) > budget / 2) --shift;
  while (shift > kSmallestShift && (vertex << shift) > kHandyPart &&
         PartsOf(file, shift - 1) <= kHandyParts) {
    --shift;
  }
  const std::uint64_t parts = PartsOf(file, shift);
  // Streams are counted as well: on a large mesh with a small budget they are many.
  const std::uint64_t streams = parts * sizeof(Stream);
  int slot_bits = kMostSlotBits;
  const std::uint64_t slot = vertex + sizeof(std::uint64_t);
  while (slot_bits > kLeastSlotBits && (slot << slot_bits) > budget / 8) --slot_bits;
  if ((vertex << shift) > budget / 2 || streams > budget / 8) return std::nullopt;
  const std::size_t questions =
      BufferBytes(budget / 4 - streams, std::max<std::uint64_t>(parts, 4), kLeastBuffer / 4);
  const std::size_t answers = BufferBytes(budget / 2, parts, 24);
  if (questions < kLeastBuffer / 4 || answers < kLeastBuffer / 4) return std::nullopt;
  return Plan{shift, slot_bits, questions, answers};
}

bool VertexJoin::Fits(const VertexFile& file, std::uint64_t budget) {
  return PlanFor(file, budget).has_value();
}

VertexJoin::VertexJoin(VertexFile& file, ScratchFolder& scratch, std::uint64_t budget)
    : file_(file),
      scratch_(scratch),
      plan_(*PlanFor(file, budget)),
      vertex_bytes_(file.vertex_bytes()),
      shift_(plan_.shift),
      slot_shift_(64 - plan_.slot_bits),
      mask_((std::uint64_t{1} << plan_.shift) - 1),
      streams_(static_cast<std::size_t>(PartsOf(file, plan_.shift))),
      known_(std::size_t{1} << plan_.slot_bits),
      positions_(known_.size() * vertex_bytes_) {}

void VertexJoin::LayOut(std::size_t bytes_each) {
  buffers_.Reset();
  char* next = buffers_.Extend(bytes_each * streams_.size()).data();
  for (Stream& stream : streams_) {
    stream.begin = stream.at = next;
    stream.end = next += bytes_each;
  }
}

Result<void> VertexJoin::BeginRecord() {
  for (std::unique_ptr<ScratchFile>* file : {&questions_, &answers_}) {
    if (*file != nullptr) continue;
    auto made = scratch_.NewFile();
    if (!made) return Forward(made);
    *file = std::move(*made);
  }
  LayOut(plan_.question_bytes);
  for (Stream& stream : streams_) stream.blocks.clear();
  blocks_ = recorded_ = asked_ = taken_ = 0;
  Forget();
  return {};
}

void VertexJoin::FlushQuestions(std::size_t part) {
  Stream& stream = streams_[part];
  const std::string_view block(stream.begin, plan_.question_bytes);
  if (auto ok = questions_->WriteAt(blocks_ * plan_.question_bytes, block); !ok) Fail(ok.error());
  stream.blocks.push_back(blocks_++);
  stream.at = stream.begin;
}

// Vertices on their way to the file of answers.
class VertexJoin::Answers {
 public:
  Answers(ScratchFile& file, std::size_t vertex_bytes)
      : file_(file), vertex_bytes_(vertex_bytes), buffer_(kLeastBuffer / 24 * 24) {}

  std::uint64_t offset() const { return offset_ + used_; }
  void Reserve(std::size_t bytes) { buffer_.resize(std::max(buffer_.size(), bytes / 24 * 24)); }

  Result<void> Add(std::span<const std::uint32_t> questions, const char* part) {
    while (!questions.empty()) {
      const std::size_t n = std::min(questions.size(), (buffer_.size() - used_) / vertex_bytes_);
      vertex_bytes_ == 12 ? Copy<12>(questions.first(n), part) : Copy<24>(questions.first(n), part);
      questions = questions.subspan(n);
      if (used_ < buffer_.size()) continue;
      if (auto ok = Flush(); !ok) return ok;
    }
    return {};
  }
  Result<void> Flush() {
    auto ok = file_.WriteAt(offset_, {buffer_.data(), used_});
    offset_ += used_;
    used_ = 0;
    return ok;
  }

 private:
  template <std::size_t kBytes>
  void Copy(std::span<const std::uint32_t> questions, const char* part) {
    char* to = buffer_.data() + used_;
    for (const std::uint32_t q : questions) {
      std::memcpy(to, part + std::size_t{q} * kBytes, kBytes);
      to += kBytes;
    }
    used_ += questions.size() * kBytes;
  }

  ScratchFile& file_;
  std::size_t vertex_bytes_;
  std::vector<char> buffer_;
  std::size_t used_ = 0;
  std::uint64_t offset_ = 0;
};

Result<void> VertexJoin::Resolve(const RunContext* context) {
  if (failure_) return failure();
  Answers answers(*answers_, vertex_bytes_);
  answers.Reserve(plan_.question_bytes);
  for (std::size_t part = 0; part < streams_.size(); ++part) {
    streams_[part].next_byte = answers.offset();
    if (auto ok = ResolvePart(part, answers, context); !ok) return ok;
    streams_[part].end_byte = answers.offset();
  }
  if (auto ok = answers.Flush(); !ok) return ok;
  part_.Reset();
  LayOut(plan_.answer_bytes);
  for (Stream& stream : streams_) stream.at = stream.end;
  Forget();
  return {};
}

Result<void> VertexJoin::ResolvePart(std::size_t part, Answers& answers,
                                     const RunContext* context) {
  Stream& stream = streams_[part];
  if (stream.blocks.empty() && stream.at == stream.begin) return {};
  const std::uint64_t first = std::uint64_t{part} << shift_;
  const auto n = static_cast<std::size_t>(std::min(mask_ + 1, file_.size() - first));
  part_.Reset();
  const std::span<char> vertices = part_.Extend(n * vertex_bytes_);
  if (auto ok = file_.Load(first, vertices); !ok) return ok;
  // The rest is still in its buffer: answered last, from there; the blocks before it are read.
  std::vector<std::uint32_t> block(plan_.question_bytes / sizeof(std::uint32_t));
  const std::span<char> bytes(reinterpret_cast<char*>(block.data()), plan_.question_bytes);
  for (const std::uint64_t at : stream.blocks) {
    if (context != nullptr && context->cancelled()) return Cancelled();
    if (auto ok = questions_->ReadAt(at * plan_.question_bytes, bytes); !ok) return ok;
    if (auto ok = answers.Add(block, vertices.data()); !ok) return ok;
  }
  const std::span<const std::uint32_t> rest(
      reinterpret_cast<const std::uint32_t*>(stream.begin),
      static_cast<std::size_t>(stream.at - stream.begin) / sizeof(std::uint32_t));
  return answers.Add(rest, vertices.data());
}

void VertexJoin::RefillAnswers(std::size_t part) {
  Stream& stream = streams_[part];
  const auto n = static_cast<std::size_t>(
      std::min<std::uint64_t>(stream.end_byte - stream.next_byte, plan_.answer_bytes));
  stream.at = stream.begin;
  stream.end = stream.begin + n;
  if (n == 0 && !failure_) {
    failure_ = Error{ErrorCode::kIo, "the input changed while it was read"};
  }
  if (failure_) {
    // Zeros for as long as the caller does not look.
    stream.end = stream.begin + plan_.answer_bytes;
    std::memset(stream.begin, 0, plan_.answer_bytes);
    return;
  }
  if (auto ok = answers_->ReadAt(stream.next_byte, {stream.begin, n}); !ok) Fail(ok.error());
  stream.next_byte += n;
}

}  // namespace strata::io
