#include "io/ply_values.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <string>

#include "io/ascii_cursor.h"
#include "io/byte_cursor.h"
#include "io/ply_value.h"

namespace strata::io {
namespace {

template <bool kSwap>
class BinaryValues final : public PlyValues {
 public:
  explicit BinaryValues(InputBuffer& input) : cursor_(input) {}

  Result<void> Seek(const PlyMark& mark) override { return cursor_.Seek(mark.offset); }
  bool BeginRow(const PlyElement&, std::uint64_t) override { return true; }
  bool EndRow() override { return true; }

  bool Value(PlyType type, char* out) override {
    const std::size_t size = PlySize(type);
    if (!cursor_.Have(size)) return false;
    const char* const from = cursor_.data();
    for (std::size_t b = 0; b < size; ++b) out[b] = from[kSwap ? size - 1 - b : b];
    cursor_.Advance(size);
    return true;
  }
  bool Skip(PlyType type, std::uint64_t values) override {
    return values == 0 || cursor_.Skip(values * PlySize(type));
  }
  bool Length(PlyType type, std::uint64_t& length) override {
    std::int64_t n = 0;
    if (!Index(type, n)) return false;
    if (n < 0) return cursor_.Reject("found list length " + std::to_string(n));
    length = static_cast<std::uint64_t>(n);
    return true;
  }
  bool Index(PlyType type, std::int64_t& index) override {
    if (!cursor_.Have(PlySize(type))) return false;
    index = LoadInteger<kSwap>(type, cursor_.data());
    cursor_.Advance(PlySize(type));
    return true;
  }
  bool Reject(const std::string& what) override { return cursor_.Reject(what); }
  tl::unexpected<Error> failure() const override { return cursor_.failure(); }

  std::uint64_t PassTriangles(std::size_t list, std::size_t stride, std::uint64_t most) override {
    if (stride > ByteCursor::kMost) return 0;
    for (std::uint64_t passed = 0;;) {
      if (passed == most) return passed;
      // Too few bytes are the business of who reads the row, and says what is missing.
      if (cursor_.available() < stride && !cursor_.Have(1)) return passed;
      const std::uint64_t n = std::min<std::uint64_t>(most - passed, cursor_.available() / stride);
      const char* row = cursor_.data();
      std::uint64_t i = 0;
      while (i < n && row[list] == 3) ++i, row += stride;
      cursor_.Advance(static_cast<std::size_t>(i) * stride);
      passed += i;
      if (i < n || n == 0) return passed;
    }
  }

 private:
  ByteCursor cursor_;
};

class AsciiValues final : public PlyValues {
 public:
  AsciiValues(InputBuffer& input, const PlyHeader& header) : cursor_(input, header.newline) {}

  Result<void> Seek(const PlyMark& mark) override { return cursor_.Seek(mark.offset, mark.line); }
  bool BeginRow(const PlyElement& element, std::uint64_t left) override {
    if (cursor_.NextRow()) return true;
    if (!cursor_.at_end()) return false;
    return cursor_.Reject("expected " + std::to_string(left) + " more of '" + element.name + "'");
  }
  bool EndRow() override { return cursor_.ExpectLineEnd(); }

  bool Value(PlyType type, char* out) override {
    if (type == PlyType::kFloat32) return Put(&AsciiCursor::ReadFloat, out);
    if (type == PlyType::kFloat64) return Put(&AsciiCursor::ReadDouble, out);
    std::int64_t value = 0;
    if (!Index(type, value)) return false;
    // Little endian: the low bytes come first.
    std::memcpy(out, &value, PlySize(type));
    return true;
  }
  bool Skip(PlyType, std::uint64_t values) override {
    for (; values > 0; --values) {
      if (!cursor_.SkipToken()) return false;
    }
    return true;
  }
  bool Length(PlyType type, std::uint64_t& length) override {
    std::int64_t n = 0;
    if (!cursor_.ReadInteger(n, 0, MostOf(type))) return false;
    length = static_cast<std::uint64_t>(n);
    return true;
  }
  bool Index(PlyType type, std::int64_t& index) override {
    const bool is_signed = static_cast<int>(type) % 2 == 0;
    return cursor_.ReadInteger(index, is_signed ? -MostOf(type) - 1 : 0, MostOf(type));
  }
  bool Reject(const std::string& what) override { return cursor_.Fault(what); }
  tl::unexpected<Error> failure() const override { return cursor_.failure(); }

 private:
  static std::int64_t MostOf(PlyType type) {
    constexpr std::array<std::int64_t, 6> kMost = {127, 255, 32767, 65535, 0x7fffffff, 0xffffffff};
    return kMost[static_cast<std::size_t>(type)];
  }
  template <class T>
  bool Put(bool (AsciiCursor::*read)(T&), char* out) {
    T value = 0;
    if (!(cursor_.*read)(value)) return false;
    std::memcpy(out, &value, sizeof value);
    return true;
  }

  AsciiCursor cursor_;
};

}  // namespace

bool PlyValues::ReadRow(const PlyElement& element, std::uint64_t left,
                        const std::vector<PlyStep>& steps, PlyRow& row) {
  return BeginRow(element, left) &&
         std::all_of(steps.begin(), steps.end(),
                     [&](const PlyStep& step) { return ReadStep(step, row); }) &&
         EndRow();
}

bool PlyValues::ReadStep(const PlyStep& step, PlyRow& row) {
  const PlyProperty& p = step.property;
  if (p.is_list) return ReadList(step, row);
  if (step.use == PlyStep::Use::kPass) return Skip(p.type, 1);
  return Value(p.type, row.kept.data() + step.at);
}

bool PlyValues::ReadList(const PlyStep& step, PlyRow& row) {
  const PlyProperty& p = step.property;
  std::uint64_t length = 0;
  if (!Length(p.count_type, length)) return false;
  switch (step.use) {
    case PlyStep::Use::kCorners:
      row.corners.clear();
      if (length > kMaxPlyCorners) return Reject("found a face of too many corners");
      for (; length > 0; --length) {
        if (!Index(p.type, row.corners.emplace_back())) return false;
      }
      return true;
    case PlyStep::Use::kKeep:
      if (length != step.length) {
        return Reject("found " + std::to_string(length) + " items in the list '" + p.name +
                      "', expected " + std::to_string(step.length) +
                      " as in the first row: only lists of one length are attributes");
      }
      for (std::uint64_t k = 0; k < length; ++k) {
        if (!Value(p.type, row.kept.data() + step.at + k * PlySize(p.type))) return false;
      }
      return true;
    case PlyStep::Use::kWedges:
      row.wedges.clear();
      if (length > step.length * kMaxPlyCorners) return Reject("found a list of too many items");
      for (std::uint64_t k = 0; k < length; ++k) {
        char value[8];
        if (!Value(p.type, value)) return false;
        row.wedges.insert(row.wedges.end(), value, value + PlySize(p.type));
      }
      return true;
    case PlyStep::Use::kPass:
      break;
  }
  return Skip(p.type, length);
}

std::unique_ptr<PlyValues> OpenPlyValues(InputBuffer& input, const PlyHeader& header) {
  if (header.encoding == PlyEncoding::kAscii) return std::make_unique<AsciiValues>(input, header);
  if (header.encoding == PlyEncoding::kBigEndian)
    return std::make_unique<BinaryValues<true>>(input);
  return std::make_unique<BinaryValues<false>>(input);
}

}  // namespace strata::io
