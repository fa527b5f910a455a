// Small records as bytes: what stands beside reservoirs in files of this machine's byte order.
#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include "core/result.h"

namespace strata {

/// Appends values; Unpacker takes them in the same order. One function template over both serves
/// both ways.
class Packer {
 public:
  template <class T>
  void Value(const T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
  }
  template <class List>
  void Range(const List& list) {
    Value(static_cast<std::uint64_t>(list.size()));
    for (const auto& element : list) Value(element);
  }
  std::string bytes;
};

class Unpacker {
 public:
  explicit Unpacker(std::string_view bytes) : rest_(bytes) {}
  template <class T>
  void Value(T& value) {
    static_assert(std::is_trivially_copyable_v<T>);
    if (rest_.size() < sizeof value) {
      good_ = false;
      return;
    }
    std::memcpy(&value, rest_.data(), sizeof value);
    rest_.remove_prefix(sizeof value);
  }
  template <class List>
  void Range(List& list) {
    std::uint64_t size = 0;
    Value(size);
    if (size > rest_.size()) good_ = false;
    for (std::uint64_t i = 0; good_ && i < size; ++i) {
      typename List::value_type element{};
      Value(element);
      list.push_back(element);
    }
  }
  /// Whether all was there, and nothing is left.
  bool done() const { return good_ && rest_.empty(); }

 private:
  std::string_view rest_;
  bool good_ = true;
};

/// Packed bytes, compressed and with a checksum. Errors: kInternal.
Result<std::string> Seal(std::string_view packed);

/// The other way; `size` is that of the packed bytes. Empty if the bytes are damaged.
std::string Unseal(std::string_view sealed, std::size_t size);

}  // namespace strata
