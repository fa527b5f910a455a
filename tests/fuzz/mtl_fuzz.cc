// Arbitrary bytes as the material library of an OBJ.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "io/byte_source.h"
#include "io/companion_file.h"
#include "io/open_mesh.h"
#include "tests/fuzz/drain.h"

namespace {

using namespace strata;

class OneFile final : public io::CompanionFiles {
 public:
  explicit OneFile(std::string bytes) : bytes_(std::move(bytes)) {}
  Result<std::unique_ptr<io::ByteSource>> Open(const std::string& relative,
                                               const std::string& who) const override {
    if (relative != "a.mtl") return Fail(ErrorCode::kNotFound, who + ": no " + relative);
    return io::MemorySource(bytes_, relative);
  }

 private:
  const std::string bytes_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string obj =
      "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\n"
      "f 1/1 2/2 3/3\nusemtl b\nf 3/3 2/2 1/1\n";
  io::OpenOptions options;
  options.max_line_bytes = 300;  // Small buffers: many more runs.
  options.companions =
      std::make_shared<OneFile>(std::string(reinterpret_cast<const char*>(data), size));
  // The surface does not depend on the library, whatever it holds.
  auto reader = io::OpenMesh(io::MemorySource(obj, "a.obj"), options);
  test::Require(reader.has_value());
  test::DrainTwice(std::move(reader));
  return 0;
}
