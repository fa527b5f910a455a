#include "io/gltf_accessor.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

namespace strata::io {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 16;
constexpr std::uint64_t kMostZeros = std::uint64_t{1} << 16;

template <class T, class Out>
Out Convert(T value, bool normalized) {
  if constexpr (std::is_same_v<Out, double> && std::is_integral_v<T>) {
    if (!normalized) return static_cast<double>(value);
    return std::max(static_cast<double>(value) / std::numeric_limits<T>::max(), -1.0);
  } else {
    return static_cast<Out>(value);
  }
}

// `n` elements that lie `stride` bytes apart.
template <class T, class Out>
void ConvertRun(const GltfAccessor& accessor, const char* from, std::uint64_t stride,
                std::uint64_t n, Out* to) {
  const std::uint32_t components = accessor.components;
  for (std::uint64_t i = 0; i < n; ++i, from += stride) {
    for (std::uint32_t k = 0; k < components; ++k) {
      T value;
      std::memcpy(&value, from + k * sizeof(T), sizeof(T));
      *to++ = Convert<T, Out>(value, accessor.normalized);
    }
  }
}

template <class Out>
void ConvertElements(const GltfAccessor& accessor, const char* from, std::uint64_t stride,
                     std::uint64_t n, Out* to) {
  switch (accessor.scalar) {
    case GltfScalar::kUint8:
      return ConvertRun<std::uint8_t>(accessor, from, stride, n, to);
    case GltfScalar::kUint16:
      return ConvertRun<std::uint16_t>(accessor, from, stride, n, to);
    case GltfScalar::kUint32:
      return ConvertRun<std::uint32_t>(accessor, from, stride, n, to);
    default:
      break;
  }
  if constexpr (std::is_same_v<Out, double>) {
    switch (accessor.scalar) {
      case GltfScalar::kInt8:
        return ConvertRun<std::int8_t>(accessor, from, stride, n, to);
      case GltfScalar::kInt16:
        return ConvertRun<std::int16_t>(accessor, from, stride, n, to);
      default:
        return ConvertRun<float>(accessor, from, stride, n, to);
    }
  }
}

// Whether `count` elements of `element` bytes, `stride` apart from `offset` on, lie in `size`.
bool Fits(std::uint64_t count, std::uint64_t element, std::uint64_t stride, std::uint64_t offset,
          std::uint64_t size) {
  if (count == 0) return true;
  if (offset > size || element > size - offset) return false;
  return stride == 0 || (count - 1) <= (size - offset - element) / stride;
}

tl::unexpected<Error> TooShort(const std::string& who, const GltfAccessor& accessor,
                               std::uint64_t stride, std::uint64_t size) {
  return Fail(ErrorCode::kCorruptInput,
              who + ": " + std::to_string(accessor.count) + " elements, " + std::to_string(stride) +
                  " bytes apart from byte " + std::to_string(accessor.offset) +
                  " on, do not fit the view's " + std::to_string(size) + " bytes");
}

}  // namespace

Result<GltfValues> GltfValues::Open(GltfBuffers& buffers, const GltfDocument& document,
                                    std::uint32_t index) {
  GltfValues values;
  const GltfAccessor& accessor = document.accessors[index];
  values.accessor_ = &accessor;
  const std::string who = buffers.name() + ": /accessors/" + std::to_string(index);
  if (accessor.view) {
    auto bytes = buffers.View(*accessor.view);
    if (!bytes) return Forward(bytes);
    values.bytes_ = std::move(*bytes);
    const GltfView& view = document.views[*accessor.view];
    const std::uint64_t stride = view.meshopt ? view.meshopt->stride : view.stride;
    values.stride_ = stride != 0 ? stride : accessor.element_bytes();
    if (!Fits(accessor.count, accessor.element_bytes(), values.stride_, accessor.offset,
              values.bytes_->size())) {
      return TooShort(who, accessor, values.stride_, values.bytes_->size());
    }
  } else if (accessor.count > std::max(kMostZeros, buffers.file_size())) {
    return Fail(ErrorCode::kOverBudget,
                who + ": " + std::to_string(accessor.count) +
                    " elements without bytes of their own, allowed are " +
                    std::to_string(std::max(kMostZeros, buffers.file_size())));
  }
  if (accessor.sparse) {
    if (auto ok = values.OpenSparse(buffers, document, who); !ok) return Forward(ok);
  }
  return values;
}

Result<void> GltfValues::OpenSparse(GltfBuffers& buffers, const GltfDocument& document,
                                    const std::string& who) {
  const GltfSparse& sparse = *accessor_->sparse;
  const std::uint64_t element = accessor_->element_bytes();
  GltfAccessor indices;
  indices.count = sparse.count;
  indices.scalar = sparse.index_scalar;
  auto index_bytes = buffers.View(sparse.index_view);
  if (!index_bytes) return Forward(index_bytes);
  auto value_bytes = buffers.View(sparse.value_view);
  if (!value_bytes) return Forward(value_bytes);
  const std::uint64_t index_size = BytesOf(sparse.index_scalar);
  const bool whole = sparse.index_scalar == GltfScalar::kUint8 ||
                     sparse.index_scalar == GltfScalar::kUint16 ||
                     sparse.index_scalar == GltfScalar::kUint32;
  if (!whole || sparse.count > accessor_->count ||
      !Fits(sparse.count, index_size, index_size, sparse.index_offset, (*index_bytes)->size()) ||
      !Fits(sparse.count, element, element, sparse.value_offset, (*value_bytes)->size())) {
    return Fail(ErrorCode::kCorruptInput,
                who + "/sparse: " + std::to_string(sparse.count) + " elements do not fit");
  }
  if (buffers.memory() != nullptr) {
    auto share = buffers.memory()->Take(sparse.count * (4 + element), who + "/sparse");
    if (!share) return Forward(share);
    share_ = std::move(*share);
  }
  const auto n = static_cast<std::size_t>(sparse.count);
  std::vector<char> raw(n * index_size);
  if (auto ok = (*index_bytes)->Read(sparse.index_offset, raw); !ok) return ok;
  sparse_indices_.resize(n);
  ConvertElements(indices, raw.data(), index_size, n, sparse_indices_.data());
  const bool ascending = std::adjacent_find(sparse_indices_.begin(), sparse_indices_.end(),
                                            std::greater_equal<>()) == sparse_indices_.end();
  if (!ascending || (n > 0 && sparse_indices_.back() >= accessor_->count)) {
    return Fail(ErrorCode::kCorruptInput,
                who + "/sparse/indices: expected to ascend and to stay below " +
                    std::to_string(accessor_->count));
  }
  sparse_values_.resize(static_cast<std::size_t>(n * element));
  return (*value_bytes)->Read(sparse.value_offset, sparse_values_);
}

Result<void> GltfValues::Read(std::uint64_t first, std::span<double> out) {
  return ReadAs(first, out);
}
Result<void> GltfValues::Read(std::uint64_t first, std::span<std::uint32_t> out) {
  return ReadAs(first, out);
}

template <class Out>
Result<void> GltfValues::ReadAs(std::uint64_t first, std::span<Out> out) {
  if (auto ok = ReadDense(first, out); !ok) return ok;
  if (sparse_indices_.empty()) return {};
  const std::uint64_t last = first + out.size() / accessor_->components;
  const std::uint64_t element = accessor_->element_bytes();
  auto it = std::lower_bound(sparse_indices_.begin(), sparse_indices_.end(), first);
  for (; it != sparse_indices_.end() && *it < last; ++it) {
    const auto k = static_cast<std::uint64_t>(it - sparse_indices_.begin());
    ConvertElements(*accessor_, sparse_values_.data() + k * element, element, 1,
                    out.data() + (*it - first) * accessor_->components);
  }
  return {};
}

template <class Out>
Result<void> GltfValues::ReadDense(std::uint64_t first, std::span<Out> out) {
  if (bytes_ == nullptr) {
    std::fill(out.begin(), out.end(), Out{});
    return {};
  }
  const std::uint64_t element = accessor_->element_bytes(), components = accessor_->components;
  for (std::uint64_t done = 0, n = out.size() / components; done < n;) {
    const std::uint64_t room = element >= kBufferBytes ? 1 : (kBufferBytes - element) / stride_ + 1;
    const std::uint64_t some = std::min(n - done, room);
    buffer_.resize(static_cast<std::size_t>((some - 1) * stride_ + element));
    const std::uint64_t at = accessor_->offset + (first + done) * stride_;
    if (auto ok = bytes_->Read(at, buffer_); !ok) return ok;
    ConvertElements(*accessor_, buffer_.data(), stride_, some, out.data() + done * components);
    done += some;
  }
  return {};
}

}  // namespace strata::io
