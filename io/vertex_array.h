// The vertices of an indexed mesh in memory, in single precision for as long as that loses nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <span>

#include "core/mesh_reader.h"

namespace strata::io {

/// An array of plain numbers that grows in place where the system can remap it.
///
/// Grown elements are not initialised, so pages that were reserved but not written cost no memory.
/// Throws std::bad_alloc, as a vector would.
template <class T>
class GrowArray {
 public:
  std::size_t size() const { return size_; }
  std::size_t capacity() const { return capacity_; }
  const T* data() const { return data_.get(); }
  T* data() { return data_.get(); }
  std::span<const T> view() const { return {data_.get(), size_}; }

  /// Appends `n` elements of unspecified value and returns them.
  std::span<T> Extend(std::size_t n) {
    if (n > capacity_ - size_) Grow(n);
    size_ += n;
    return {data_.get() + (size_ - n), n};
  }
  /// Gives back everything.
  void Reset() {
    data_.reset();
    size_ = capacity_ = 0;
  }

 private:
  struct Free {
    void operator()(T* p) const { std::free(p); }
  };
  void Grow(std::size_t n) {
    constexpr std::size_t kMax = PTRDIFF_MAX / sizeof(T);
    if (n > kMax - size_) throw std::bad_alloc();
    const std::size_t generous = capacity_ > kMax / 2 ? kMax : capacity_ + capacity_ / 2 + 64;
    const std::size_t wanted = generous > size_ + n ? generous : size_ + n;
    void* grown = std::realloc(data_.get(), wanted * sizeof(T));
    if (grown == nullptr) throw std::bad_alloc();
    static_cast<void>(data_.release());
    data_.reset(static_cast<T*>(grown));
    capacity_ = wanted;
  }

  std::unique_ptr<T, Free> data_;
  std::size_t size_ = 0, capacity_ = 0;
};

/// Vertices, appended one by one or in bulk.
///
/// Holds floats while every coordinate appended is exactly a float (NaN and the infinities count as
/// floats), and turns the whole into doubles at the first that is not. Growth is amortised; nothing
/// is reserved ahead of what is appended. Threads: one at a time. Throws std::bad_alloc.
class VertexArray {
 public:
  /// Number of vertices.
  std::size_t size() const { return (floats_.size() + doubles_.size()) / 3; }
  bool is_double() const { return is_double_; }
  std::uint64_t bytes() const {
    return floats_.size() * sizeof(float) + doubles_.size() * sizeof(double);
  }
  /// Gives everything back; empty and of single precision again.
  void Reset();
  /// Valid until the next change or destruction.
  VertexView view() const { return {floats_.view(), doubles_.view()}; }

  void Append(double x, double y, double z) {
    if (!is_double_) {
      if (IsFloat(x) && IsFloat(y) && IsFloat(z)) {
        const std::span<float> to = floats_.Extend(3);
        to[0] = static_cast<float>(x);
        to[1] = static_cast<float>(y);
        to[2] = static_cast<float>(z);
        return;
      }
      TurnIntoDoubles();
    }
    const std::span<double> to = doubles_.Extend(3);
    to[0] = x, to[1] = y, to[2] = z;
  }

  /// Appends `n` vertices and returns their 3*n floats to be filled in. Precondition: !is_double(),
  /// and `n` vertices' worth of input has been seen (it is allocated at once).
  std::span<float> ExtendFloat(std::size_t n) { return floats_.Extend(3 * n); }

  /// Appends the vertices x0,y0,z0,x1,… whatever the present precision.
  void AppendFloats(std::span<const float> xyz);
  /// The same from doubles; stays in single precision if every one of them allows it.
  void AppendDoubles(std::span<const double> xyz);

  /// True if `value` survives the way to float and back.
  static bool IsFloat(double value) {
    return static_cast<double>(static_cast<float>(value)) == value || value != value;
  }

 private:
  void TurnIntoDoubles();

  bool is_double_ = false;
  GrowArray<float> floats_;
  GrowArray<double> doubles_;
};

}  // namespace strata::io
