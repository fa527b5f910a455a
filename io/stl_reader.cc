#include "io/stl_reader.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <new>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "io/ascii_cursor.h"
#include "io/byte_cursor.h"
#include "io/stl_attributes.h"

namespace strata::io {
namespace {

constexpr std::size_t kHeaderBytes = 80, kCountBytes = 4, kFacetBytes = 50;
constexpr std::size_t kDataOffset = kHeaderBytes + kCountBytes;
constexpr std::size_t kWindowBytes = std::size_t{1} << 18;

std::uint32_t LoadCount(const char* header) {
  std::uint32_t count;
  std::memcpy(&count, header + kHeaderBytes, sizeof(count));
  return count;
}

// What ascii and binary have in common.
class StlReader : public MeshReader {
 public:
  StlReader(std::unique_ptr<ByteSource> source, const char* encoding)
      : source_(std::move(source)), input_(*source_, kWindowBytes) {
    info_ = {"stl", encoding, source_->compression()};
  }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return {}; }
  const ReadCounts& counts() const override { return counts_; }
  std::uint64_t bytes_read() const override { return source_->stored_position(); }
  std::optional<std::uint64_t> bytes_total() const override { return source_->stored_size(); }

 protected:
  void CountFacets(std::size_t n) {
    counts_.faces += n;
    counts_.triangles += n;
    counts_.vertices += 3 * n;
  }

  std::unique_ptr<ByteSource> source_;
  InputBuffer input_;
  MeshInfo info_;
  ReadCounts counts_;
};

// Writes `n` facets into the columns of `batch` from its size on.
void CopyFacets(const char* facets, std::size_t n, std::uint64_t first_id, TriangleBatch& batch) {
  constexpr std::size_t kNormalBytes = 12;
  const std::size_t column = static_cast<std::size_t>(batch.column(1) - batch.column(0));
  double* to = batch.column(0) + batch.size();
  std::uint64_t* ids = batch.ids() + batch.size();
  for (std::size_t i = 0; i < n; ++i, facets += kFacetBytes) {
    float corners[9];
    std::memcpy(corners, facets + kNormalBytes, sizeof(corners));
    for (std::size_t k = 0; k < 9; ++k) to[k * column + i] = static_cast<double>(corners[k]);
    ids[i] = first_id + i;
  }
  batch.set_size(batch.size() + n);
}

class BinaryStlReader : public StlReader {
 public:
  explicit BinaryStlReader(std::unique_ptr<ByteSource> source)
      : StlReader(std::move(source), "binary_little_endian"), cursor_(input_) {}

  Result<void> Open() {
    if (!cursor_.Have(kDataOffset)) return cursor_.failure();
    facets_ = LoadCount(cursor_.data());
    colors_ = StlColors::Of({cursor_.data(), cursor_.available()});
    attributes_ = colors_.Attributes();
    cursor_.Advance(kDataOffset);
    const auto size = source_->size();
    if (const std::uint64_t need = kDataOffset + std::uint64_t{facets_} * kFacetBytes;
        size && *size < need) {
      cursor_.Reject("the header counts " + std::to_string(facets_) +
                     " facets, for which the file " + "must have " + std::to_string(need) +
                     " bytes; found " + std::to_string(*size));
      return cursor_.failure();
    }
    return {};
  }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    batch.Clear();
    while (!batch.full()) {
      if (auto ok = EnterRun(); !ok) return Forward(ok);
      if (next_ == facets_) break;
      if (!cursor_.Have(kFacetBytes)) return cursor_.failure();
      const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(
          {run_end_ - next_, cursor_.available() / kFacetBytes, batch.capacity() - batch.size()}));
      CopyFacets(cursor_.data(), n, next_, batch);
      cursor_.Advance(n * kFacetBytes);
      next_ += n;
      CountFacets(n);
    }
    if (!batch.full()) {
      if (auto ok = cursor_.ExpectPaddingOnly(); !ok) return Forward(ok);
    }
    return batch.size();
  }

  std::span<const MeshAttribute> attributes() const override { return attributes_; }
  Result<std::unique_ptr<AttributePass>> ReadAttributes(std::span<const std::size_t> numbers,
                                                        RunContext& context) override {
    std::vector<MeshAttribute> wanted;
    for (const std::size_t n : numbers) wanted.push_back(attributes_[n]);
    input_.Forget();
    return OpenStlAttributes(*source_, colors_, wanted, context);
  }

  // Of a file of known size Open has seen that all facets are there, each in its place.
  bool SelectShare(const Share& share) override {
    const bool can = share.whole() || (source_->compression() == "none" && source_->size());
    share_ = can ? share : Share{};
    run_end_ = next_;
    return can;
  }

  Result<void> Rewind() override {
    counts_ = {};
    next_ = run_end_ = 0;
    return cursor_.Seek(kDataOffset);
  }

 private:
  static std::uint64_t OffsetOf(std::uint64_t facet) { return kDataOffset + facet * kFacetBytes; }

  // Goes to the share's next facet, or behind the last facet of all.
  Result<void> EnterRun() {
    if (next_ < run_end_) return {};
    const std::uint64_t from = next_;
    next_ = std::min<std::uint64_t>(share_.Next(from), facets_);
    run_end_ = next_ == facets_ ? facets_ : std::min<std::uint64_t>(share_.RunEnd(next_), facets_);
    cursor_.LimitAhead(run_end_ == facets_ ? UINT64_MAX : OffsetOf(run_end_));
    return next_ == from ? Result<void>() : cursor_.Seek(OffsetOf(next_));
  }

  ByteCursor cursor_;
  std::uint32_t facets_ = 0;
  StlColors colors_;
  std::vector<MeshAttribute> attributes_;
  Share share_;
  std::uint64_t next_ = 0, run_end_ = 0;  // The next facet, and one past the last of its run.
};

bool EqualsLower(std::string_view text, std::string_view lower) {
  return std::equal(text.begin(), text.end(), lower.begin(), lower.end(), [](char a, char b) {
    return (a >= 'A' && a <= 'Z' ? static_cast<char>(a - 'A' + 'a') : a) == b;
  });
}

class AsciiStlReader : public StlReader {
 public:
  explicit AsciiStlReader(std::unique_ptr<ByteSource> source)
      : StlReader(std::move(source), "ascii"), cursor_(input_) {}

  Result<void> Open() {
    // Some editors mark UTF-8 by three bytes in front.
    auto window = input_.Peek(3);
    if (!window) return Forward(window);
    start_ = window->starts_with("\xef\xbb\xbf") ? 3 : 0;
    return Rewind();
  }

  Result<std::size_t> Read(TriangleBatch& batch) override {
    batch.Clear();
    while (!batch.full()) {
      const Next next = in_solid_ ? ReadFacet(batch) : BeginSolid();
      if (next == Next::kFailed) return cursor_.failure();
      if (next == Next::kEnd) break;
    }
    return batch.size();
  }

  Result<void> Rewind() override {
    counts_ = {};
    in_solid_ = seen_solid_ = false;
    return cursor_.Seek(start_, 1);
  }

 private:
  enum class Next { kGoOn, kEnd, kFailed };

  // Takes `keyword`, which must be next.
  bool Expect(const char* keyword) {
    if (!cursor_.NextRow() && !cursor_.at_end()) return false;
    return TakeIf(keyword) || cursor_.Reject(std::string("expected '") + keyword + "'");
  }
  // The same, and ignores the rest of its line.
  bool ExpectLine(const char* keyword) { return Expect(keyword) && cursor_.SkipLine(); }

  bool TakeIf(std::string_view keyword) {
    if (!EqualsLower(cursor_.PeekToken(), keyword)) return false;
    cursor_.Advance(keyword.size());
    return true;
  }

  Next BeginSolid() {
    if (!cursor_.NextRow() && cursor_.at_end() && seen_solid_) return Next::kEnd;
    if (!ExpectLine("solid")) return Next::kFailed;
    in_solid_ = seen_solid_ = true;
    return Next::kGoOn;
  }

  // One facet, or the end of the solid.
  Next ReadFacet(TriangleBatch& batch) {
    if (!cursor_.NextRow() && !cursor_.at_end()) return Next::kFailed;
    if (TakeIf("endsolid")) {
      in_solid_ = false;
      return cursor_.SkipLine() ? Next::kGoOn : Next::kFailed;
    }
    if (!TakeIf("facet")) {
      cursor_.Reject("expected 'facet' or 'endsolid'");
      return Next::kFailed;
    }
    Vec3 corners[3];
    const bool ok = cursor_.SkipLine() && ExpectLine("outer") && ReadVertex(corners[0]) &&
                    ReadVertex(corners[1]) && ReadVertex(corners[2]) && ExpectLine("endloop") &&
                    ExpectLine("endfacet");
    if (!ok) return Next::kFailed;
    batch.Push(corners[0], corners[1], corners[2], counts_.triangles);
    CountFacets(1);
    return Next::kGoOn;
  }

  bool ReadVertex(Vec3& corner) {
    float x = 0, y = 0, z = 0;
    if (!Expect("vertex") || !cursor_.ReadFloat(x) || !cursor_.ReadFloat(y) ||
        !cursor_.ReadFloat(z)) {
      return false;
    }
    corner = {static_cast<double>(x), static_cast<double>(y), static_cast<double>(z)};
    return cursor_.ExpectLineEnd();
  }

  AsciiCursor cursor_;
  std::uint64_t start_ = 0;
  bool in_solid_ = false, seen_solid_ = false;
};

// Opens a reader of one of the two kinds.
template <class Reader>
Result<std::unique_ptr<MeshReader>> Make(std::unique_ptr<ByteSource> source) {
  auto reader = std::make_unique<Reader>(std::move(source));
  if (auto ok = reader->Open(); !ok) return Forward(ok);
  return reader;
}

Result<bool> IsBinary(ByteSource& source) {
  constexpr std::size_t kLook = 4096;
  InputBuffer look(source, kLook);
  auto head = look.Peek(kLook);
  if (!head) return Forward(head);
  const auto size =
      head->size() < kLook ? std::optional<std::uint64_t>(head->size()) : source.size();
  const bool binary = IsBinaryStl(*head, size);
  if (auto ok = source.Seek(0); !ok) return Forward(ok);
  return binary;
}

}  // namespace

bool HasBinaryStlSize(std::string_view head, std::optional<std::uint64_t> size) {
  return size && head.size() >= kDataOffset &&
         *size == kDataOffset + std::uint64_t{LoadCount(head.data())} * kFacetBytes;
}

bool CouldBeBinaryStl(std::string_view head) {
  constexpr std::size_t kLook = 64;
  if (head.size() < kDataOffset + kFacetBytes) return false;
  const std::size_t facets = std::min<std::size_t>(
      {LoadCount(head.data()), kLook, (head.size() - kDataOffset) / kFacetBytes});
  for (std::size_t i = 0; i < facets; ++i) {
    std::array<float, 12> values;
    std::memcpy(values.data(), head.data() + kDataOffset + i * kFacetBytes, sizeof(values));
    const bool likely = std::all_of(values.begin(), values.end(), [](float f) {
      return f == 0 || (std::fabs(f) > 1e-30f && std::fabs(f) < 1e30f);
    });
    if (!likely) return false;
  }
  return facets > 0;
}

bool IsBinaryStl(std::string_view head, std::optional<std::uint64_t> size) {
  if (HasBinaryStlSize(head, size)) return true;
  if (head.starts_with("\xef\xbb\xbf")) head.remove_prefix(3);
  const std::size_t ink = std::min(head.find_first_not_of(" \t\r\n\v\f"), head.size());
  if (!EqualsLower(head.substr(ink, 5), "solid")) return true;
  return head.find('\0') != std::string_view::npos;
}

Result<std::unique_ptr<MeshReader>> OpenStl(std::unique_ptr<ByteSource> source,
                                            const OpenOptions&) {
  try {
    auto binary = IsBinary(*source);
    if (!binary) return Forward(binary);
    return *binary ? Make<BinaryStlReader>(std::move(source))
                   : Make<AsciiStlReader>(std::move(source));
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, "out of memory while opening an STL file");
  }
}

}  // namespace strata::io
