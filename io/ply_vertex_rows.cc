#include "io/ply_vertex_rows.h"

#include <span>
#include <vector>

namespace strata::io {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 15;

class PlyVertexFile : public VertexFile {
 public:
  PlyVertexFile(ByteSource& source, const PlyVertexRows& rows, std::uint64_t offset,
                std::uint64_t count)
      : source_(source),
        rows_(rows),
        is_double_(rows.is_double()),
        offset_(offset),
        count_(count),
        at_once_(std::max<std::size_t>(kBufferBytes / rows.stride, 1)),
        buffer_(rows.bare() ? 0 : at_once_ * rows.stride) {}

  std::uint64_t size() const override { return count_; }
  bool is_double() const override { return is_double_; }

  Result<void> Load(std::uint64_t first, std::span<char> out) override {
    if (rows_.bare()) return source_.ReadAt(offset_ + first * rows_.stride, out);
    for (std::size_t n = out.size() / vertex_bytes(); n > 0;) {
      const std::size_t some = std::min(n, at_once_);
      const std::span<char> raw = std::span(buffer_).first(some * rows_.stride);
      if (auto ok = source_.ReadAt(offset_ + first * rows_.stride, raw); !ok) return ok;
      Decode(some, out.data());
      out = out.subspan(some * vertex_bytes());
      first += some;
      n -= some;
    }
    return {};
  }

 private:
  void Decode(std::size_t n, char* to) const {
    if (is_double_) return DecodeAs<double>(n, to);
    if (!rows_.all_float32()) return DecodeAs<float>(n, to);
    float* const floats = reinterpret_cast<float*>(to);
    rows_.swap ? CopyPlyFloats<true>(rows_, buffer_.data(), n, floats)
               : CopyPlyFloats<false>(rows_, buffer_.data(), n, floats);
  }
  template <class T>
  void DecodeAs(std::size_t n, char* to) const {
    const char* from = buffer_.data();
    for (; n > 0; --n, from += rows_.stride, to += 3 * sizeof(T)) {
      T xyz[3];
      for (std::size_t a = 0; a < 3; ++a) xyz[a] = static_cast<T>(Number(a, from));
      std::memcpy(to, xyz, sizeof(xyz));
    }
  }
  double Number(std::size_t a, const char* row) const {
    const auto [offset, type] = rows_.axes[a];
    return rows_.swap ? LoadNumber<true>(type, row + offset)
                      : LoadNumber<false>(type, row + offset);
  }

  ByteSource& source_;
  const PlyVertexRows rows_;
  const bool is_double_;
  const std::uint64_t offset_, count_;
  const std::size_t at_once_;
  std::vector<char> buffer_;
};

}  // namespace

std::unique_ptr<VertexFile> OpenPlyVertexFile(ByteSource& source, const PlyVertexRows& rows,
                                              std::uint64_t offset, std::uint64_t count) {
  return std::make_unique<PlyVertexFile>(source, rows, offset, count);
}

}  // namespace strata::io
