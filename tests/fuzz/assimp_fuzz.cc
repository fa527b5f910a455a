// Arbitrary bytes as what strata-assimp writes; the first says which of its runs it is.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "io/assimp_records.h"
#include "io/assimp_stream.h"
#include "tests/fuzz/drain.h"

namespace {

using namespace strata;

class Bytes final : public io::AssimpFeed {
 public:
  explicit Bytes(std::span<const std::uint8_t> bytes) : bytes_(bytes) {}
  Result<void> Take(std::span<char> out) override {
    if (out.size() > bytes_.size()) return Fail(ErrorCode::kCorruptInput, "the end");
    std::memcpy(out.data(), bytes_.data(), out.size());
    bytes_ = bytes_.subspan(out.size());
    return {};
  }

 private:
  std::span<const std::uint8_t> bytes_;
};

void CheckColumns(const io::AssimpHead& head) {
  const io::AssimpColumns columns = io::ListAssimpColumns(head);
  test::Require(columns.offsets.size() == columns.attributes.size());
  for (std::size_t k = 0; k < columns.offsets.size(); ++k) {
    const MeshAttribute& attribute = columns.attributes[k];
    const std::size_t end = columns.offsets[k] + static_cast<std::size_t>(attribute.components);
    test::Require(end <= (attribute.carry == Carry::kConstant ? 3 : head.width()));
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const bool attributes = data[0] % 2 == 1;
  Bytes bytes({data + 1, size - 1});
  io::AssimpRecords records("a.fbx", bytes, attributes);
  const auto head = records.Head();
  if (!head) {
    test::Require(!head.error().message.empty());
    return 0;
  }
  CheckColumns(*head);
  io::AssimpPolygon polygon;
  for (;;) {
    const auto more = records.Next(polygon);
    if (!more || !*more) break;
    test::Require(polygon.corners.size() <= io::kMostAssimpCorners);
    test::Require(polygon.values.size() ==
                  (attributes ? head->width() * polygon.corners.size() : 0));
  }
  return 0;
}
