// One binary value of a PLY file.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>

#include "io/ply_header.h"

namespace strata::io {

static_assert(std::endian::native == std::endian::little, "kSwap below means 'big-endian file'");

inline std::uint8_t SwapBytes(std::uint8_t v) { return v; }
inline std::uint16_t SwapBytes(std::uint16_t v) { return __builtin_bswap16(v); }
inline std::uint32_t SwapBytes(std::uint32_t v) { return __builtin_bswap32(v); }
inline std::uint64_t SwapBytes(std::uint64_t v) { return __builtin_bswap64(v); }

/// The bits at `p`, in the file's byte order.
template <class Bits, bool kSwap>
Bits LoadBits(const char* p) {
  Bits bits;
  std::memcpy(&bits, p, sizeof(bits));
  if constexpr (kSwap) bits = SwapBytes(bits);
  return bits;
}

/// An integer type's value. Precondition: IsInteger(type).
template <bool kSwap>
std::int64_t LoadInteger(PlyType type, const char* p) {
  switch (type) {
    case PlyType::kInt8:
      return static_cast<std::int8_t>(*p);
    case PlyType::kUint8:
      return static_cast<std::uint8_t>(*p);
    case PlyType::kInt16:
      return static_cast<std::int16_t>(LoadBits<std::uint16_t, kSwap>(p));
    case PlyType::kUint16:
      return LoadBits<std::uint16_t, kSwap>(p);
    case PlyType::kInt32:
      return static_cast<std::int32_t>(LoadBits<std::uint32_t, kSwap>(p));
    default:
      return LoadBits<std::uint32_t, kSwap>(p);
  }
}

/// Any type's value; every PLY type fits a double.
template <bool kSwap>
double LoadNumber(PlyType type, const char* p) {
  if (type == PlyType::kFloat32) {
    return static_cast<double>(std::bit_cast<float>(LoadBits<std::uint32_t, kSwap>(p)));
  }
  if (type == PlyType::kFloat64) return std::bit_cast<double>(LoadBits<std::uint64_t, kSwap>(p));
  return static_cast<double>(LoadInteger<kSwap>(type, p));
}

}  // namespace strata::io
