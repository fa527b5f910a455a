// What the writer of vdb files sends to strata-vdb, and what that answers. Both are of one build
// and on one machine: numbers are in its byte order.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace strata::io {

/// Where strata-vdb finds the file that it is to fill; the stream is its standard input, and so is
/// the way of the answer.
inline constexpr int kVdbOutput = 3;

/// How positions within a voxel are stored.
enum class VdbCodec : std::uint8_t { kFixed8, kFixed16, kFloat };
enum class VdbType : std::uint8_t { kInt8, kInt16, kInt32, kInt64, kFloat, kDouble };

constexpr std::size_t SizeOf(VdbType type) {
  constexpr std::size_t kSizes[] = {1, 2, 4, 8, 4, 8};
  return kSizes[static_cast<std::size_t>(type)];
}

/// An attribute of points beside the position, as OpenVDB stores it.
struct VdbAttribute {
  std::string name;  ///< One that OpenVDB takes.
  VdbType type = VdbType::kFloat;
  std::uint32_t components = 1;  ///< 1 to kMostComponents.
  bool vector = false;           ///< A Vec3 a point rather than a stride; three floats or doubles.

  std::size_t bytes() const { return SizeOf(type) * components; }
};

/// The grid but for its points. First on the stream, packed, after its length in 64 bits.
struct VdbHead {
  double edge = 1;                      ///< A voxel's, world units.
  std::array<double, 3> first_voxel{};  ///< The middle of the voxel (0,0,0), world units.
  std::uint64_t count = 0;              ///< Points that follow.
  std::uint64_t memory_bytes = 0;       ///< What the grid may take; 0 = no bound.
  VdbCodec codec = VdbCodec::kFloat;
  std::string uuid;  ///< 36 characters, in place of those that OpenVDB draws at random.
  std::string creator;
  std::vector<VdbAttribute> attributes;
  std::vector<std::pair<std::string, std::string>> metadata;
};

/// Then each point: this, then its attributes one after the other, then zeros up to VdbRowBytes.
/// Points of one leaf (8^3 voxels) follow each other.
struct VdbPlace {
  std::array<std::int32_t, 3> voxel;
  std::array<float, 3> position;  ///< From the voxel's middle in edges, [-0.5, 0.5).
};

/// A multiple of 8.
inline std::size_t VdbRowBytes(const std::vector<VdbAttribute>& attributes) {
  std::size_t bytes = sizeof(VdbPlace);
  for (const VdbAttribute& attribute : attributes) bytes += attribute.bytes();
  return (bytes + 7) / 8 * 8;
}

/// The answer, once: this, then `text_bytes` characters.
struct VdbAnswer {
  enum Kind : std::uint32_t {
    kDone,        ///< `number` = bytes of the file.
    kOverMemory,  ///< `number` = bytes that the grid would have taken, or 0: nobody knows.
    kDisk,        ///< `number` = errno of writing the file.
    kFailed       ///< For reasons that the text gives.
  };
  Kind kind = kFailed;
  std::uint32_t text_bytes = 0;
  std::uint64_t number = 0;
};

/// `packing` is a Packer or an Unpacker (core/packing.h).
template <class Packing>
void PackHead(VdbHead& head, Packing& packing) {
  const auto list = [&packing](auto& items, const auto& pack) {
    auto size = static_cast<std::uint64_t>(items.size());
    packing.Value(size);
    constexpr std::uint64_t kMost = 1 << 16;
    items.resize(static_cast<std::size_t>(std::min(size, kMost)));
    for (auto& item : items) pack(item);
  };
  packing.Value(head.edge);
  packing.Value(head.first_voxel);
  packing.Value(head.count);
  packing.Value(head.memory_bytes);
  packing.Value(head.codec);
  packing.Range(head.uuid);
  packing.Range(head.creator);
  list(head.attributes, [&packing](VdbAttribute& attribute) {
    packing.Range(attribute.name);
    packing.Value(attribute.type);
    packing.Value(attribute.components);
    packing.Value(attribute.vector);
  });
  list(head.metadata, [&packing](auto& entry) {
    packing.Range(entry.first);
    packing.Range(entry.second);
  });
}

}  // namespace strata::io
