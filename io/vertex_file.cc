#include "io/vertex_file.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

namespace strata::io {
namespace {

constexpr std::size_t kPieceNumbers = 3 * 1024;  // As many are converted at a time.

template <class T>
std::string_view BytesOf(std::span<const T> numbers) {
  return {reinterpret_cast<const char*>(numbers.data()), numbers.size_bytes()};
}

}  // namespace

Result<void> ScratchVertices::Append(const VertexView& vertices) {
  if (file_ == nullptr) {
    auto file = scratch_.NewFile();
    if (!file) return Forward(file);
    file_ = std::move(*file);
  }
  const bool doubles = !vertices.f64.empty();
  if (doubles && !is_double_) {
    if (auto ok = TurnIntoDoubles(); !ok) return ok;
  }
  auto ok = doubles      ? file_->Append(BytesOf(vertices.f64))
            : is_double_ ? AppendWidened(vertices.f32)
                         : file_->Append(BytesOf(vertices.f32));
  if (ok) size_ += vertices.size();
  return ok;
}

Result<void> ScratchVertices::AppendWidened(std::span<const float> xyz) {
  std::array<double, kPieceNumbers> piece;
  while (!xyz.empty()) {
    const std::size_t n = std::min(xyz.size(), piece.size());
    std::copy_n(xyz.begin(), n, piece.begin());
    if (auto ok = file_->Append(BytesOf(std::span<const double>(piece).first(n))); !ok) return ok;
    xyz = xyz.subspan(n);
  }
  return {};
}

// Happens once at most: from then on the file stays double.
Result<void> ScratchVertices::TurnIntoDoubles() {
  is_double_ = true;
  if (size_ == 0) return {};
  auto wider = scratch_.NewFile();
  if (!wider) return Forward(wider);
  const std::unique_ptr<ScratchFile> floats = std::exchange(file_, std::move(*wider));
  std::array<float, kPieceNumbers> piece;
  for (std::uint64_t at = 0; at < 3 * size_;) {
    const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(3 * size_ - at, piece.size()));
    const std::span<float> numbers = std::span(piece).first(n);
    const std::span<char> bytes(reinterpret_cast<char*>(piece.data()), numbers.size_bytes());
    if (auto ok = floats->ReadAt(at * sizeof(float), bytes); !ok) return ok;
    if (auto ok = AppendWidened(numbers); !ok) return ok;
    at += n;
  }
  return {};
}

Result<void> ScratchVertices::Load(std::uint64_t first, std::span<char> out) {
  return file_->ReadAt(first * vertex_bytes(), out);
}

}  // namespace strata::io
