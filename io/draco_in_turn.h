// Draco's sequential encoder and decoder, taking one attribute after the other: the same bytes as
// its own, in a fraction of the memory. Included by the sources that call Draco alone.
#pragma once

#include <cstdint>
#include <functional>

namespace draco {
class EncoderBuffer;
template <class Key>
class EncoderOptionsBase;
class PointAttribute;
class PointCloud;
class Status;
}  // namespace draco

namespace strata::io {

/// Writes the values of the attribute `id` into its storage, which has room for all points.
/// Returns false to give up.
using FillAttribute = std::function<bool(int id, draco::PointAttribute& attribute)>;

/// An attribute for which this option is 1 is stored byte by byte, as Draco does with doubles: for
/// integers so far apart that its entropy coder would need a table for them.
inline constexpr const char* kRawOption = "strata_raw";

/// Encodes a cloud whose attributes have no storage yet: each gets it when its turn comes and loses
/// it afterwards. Draco's own way transforms all attributes before it encodes the first.
draco::Status EncodeInTurn(draco::PointCloud& cloud,
                           const draco::EncoderOptionsBase<std::int32_t>& options,
                           const FillAttribute& fill, draco::EncoderBuffer& buffer);

/// Decodes all of a cloud that the sequential encoder made, and keeps the positions alone; other
/// attributes are decoded and dropped.
draco::Status DecodePositions(const draco::EncoderBuffer& buffer, draco::PointCloud& cloud);

}  // namespace strata::io
