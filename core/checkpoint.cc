#include "core/checkpoint.h"

#include <cstring>

#include "core/packing.h"

namespace strata {
namespace {

constexpr std::uint64_t kMagic = 0x31504b4354525453;  // "STRTCKP1"
constexpr std::uint64_t kMostBytes = 64 << 20;

struct Header {
  std::uint64_t magic, packed_bytes;
};

template <class Archive, class Item>
void Fields(Archive& archive, Item& item) {
  archive.Value(item.lattice);
  archive.Range(item.probes);
  archive.Value(item.scan);
  archive.Range(item.runs);
}

}  // namespace

Result<std::string> PackCheckpoint(const Checkpoint& checkpoint) {
  Packer packer;
  packer.Value(checkpoint.bounds.has_value());
  packer.Value(checkpoint.bounds.value_or(Bounds{}));
  Fields(packer, checkpoint);
  const auto sealed = Seal(packer.bytes);
  if (!sealed) return Forward(sealed);
  const Header header{kMagic, packer.bytes.size()};
  return std::string(reinterpret_cast<const char*>(&header), sizeof header) + *sealed;
}

Result<Checkpoint> UnpackCheckpoint(std::string_view bytes) {
  const auto damaged = [] { return Fail(ErrorCode::kIo, "damaged checkpoint"); };
  Header header{};
  if (bytes.size() < sizeof header) return damaged();
  std::memcpy(&header, bytes.data(), sizeof header);
  if (header.magic != kMagic || header.packed_bytes > kMostBytes) return damaged();
  const std::string packed = Unseal(bytes.substr(sizeof header), header.packed_bytes);
  Unpacker unpacker(packed);
  Checkpoint checkpoint;
  bool bounded = false;
  Bounds bounds;
  unpacker.Value(bounded);
  unpacker.Value(bounds);
  Fields(unpacker, checkpoint);
  if (bounded) checkpoint.bounds = bounds;
  if (!unpacker.done()) return damaged();
  return checkpoint;
}

}  // namespace strata
