#include "io/vertex_array.h"

#include <algorithm>

namespace strata::io {

void VertexArray::Reset() {
  floats_.Reset();
  doubles_.Reset();
  is_double_ = false;
}

void VertexArray::TurnIntoDoubles() {
  const std::span<double> to = doubles_.Extend(floats_.size());
  std::copy_n(floats_.data(), floats_.size(), to.data());
  floats_.Reset();
  is_double_ = true;
}

void VertexArray::AppendFloats(std::span<const float> xyz) {
  if (is_double_) {
    std::copy(xyz.begin(), xyz.end(), doubles_.Extend(xyz.size()).begin());
  } else {
    std::copy(xyz.begin(), xyz.end(), floats_.Extend(xyz.size()).begin());
  }
}

void VertexArray::AppendDoubles(std::span<const double> xyz) {
  if (!is_double_ && std::all_of(xyz.begin(), xyz.end(), IsFloat)) {
    std::transform(xyz.begin(), xyz.end(), floats_.Extend(xyz.size()).begin(),
                   [](double value) { return static_cast<float>(value); });
    return;
  }
  if (!is_double_) TurnIntoDoubles();
  std::copy(xyz.begin(), xyz.end(), doubles_.Extend(xyz.size()).begin());
}

}  // namespace strata::io
