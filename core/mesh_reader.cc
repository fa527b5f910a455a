#include "core/mesh_reader.h"

#include <new>

namespace strata {
namespace {
constexpr std::size_t kPad = 16;
constexpr std::align_val_t kAlign{64};
std::size_t PaddedStride(std::size_t capacity) {
  const std::size_t stride = (capacity + 2 * kPad - 1) / kPad * kPad;
  // Columns a multiple of 4 KiB apart would all fall into the same cache sets.
  return stride % 512 == 0 ? stride + kPad : stride;
}
}  // namespace

void TriangleBatch::Free::operator()(double* p) const { ::operator delete[](p, kAlign); }

TriangleBatch::TriangleBatch(std::size_t capacity)
    : capacity_(capacity),
      stride_(PaddedStride(capacity)),
      storage_(new (kAlign) double[9 * PaddedStride(capacity)]()),
      columns_(storage_.get()),
      ids_(stride_) {}

}  // namespace strata
