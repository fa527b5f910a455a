#include "io/gltf_container.h"

#include <array>
#include <cstring>
#include <string>
#include <utility>

namespace strata::io {
namespace {

constexpr std::uint64_t kHeaderBytes = 12, kChunkHeaderBytes = 8;
constexpr std::uint32_t kJsonChunk = 0x4e4f534a, kBinaryChunk = 0x004e4942;

class Opener {
 public:
  Opener(GltfContainer& container, const OpenOptions& options)
      : container_(container),
        source_(*container.source),
        size_(source_.size().value_or(0)),
        options_(options) {}

  Result<void> Open() {
    std::array<char, 4> magic{};
    if (size_ >= magic.size()) {
      if (auto ok = source_.ReadAt(0, magic); !ok) return ok;
    }
    container_.binary = std::string_view(magic.data(), magic.size()) == "glTF";
    return container_.binary ? OpenGlb() : ReadJson(0, size_);
  }

 private:
  tl::unexpected<Error> Corrupt(std::uint64_t at, const std::string& what) const {
    return Fail(ErrorCode::kCorruptInput,
                source_.name() + ": byte " + std::to_string(at) + ": " + what);
  }

  template <std::size_t n>
  Result<std::array<std::uint32_t, n>> Words(std::uint64_t at, const char* what) {
    std::array<std::uint32_t, n> words{};
    if (size_ < at || size_ - at < 4 * n) {
      return Corrupt(size_, std::string("found the end of the file in ") + what);
    }
    std::array<char, 4 * n> bytes;
    if (auto ok = source_.ReadAt(at, bytes); !ok) return Forward(ok);
    std::memcpy(words.data(), bytes.data(), bytes.size());
    return words;
  }

  Result<void> OpenGlb() {
    const auto header = Words<3>(0, "the header of a GLB file");
    if (!header) return Forward(header);
    const auto [magic, version, length] = *header;
    if (version != 2) {
      return Fail(ErrorCode::kUnsupported, source_.name() + ": byte 4: found GLB version " +
                                               std::to_string(version) + ", expected 2");
    }
    if (length > size_) {
      return Corrupt(8, "the header says " + std::to_string(length) + " bytes, the file has " +
                            std::to_string(size_));
    }
    size_ = length;
    return ReadChunks();
  }

  Result<void> ReadChunks() {
    std::uint64_t at = kHeaderBytes;
    for (int number = 0; at < size_; ++number) {
      const auto header = Words<2>(at, "a chunk's header");
      if (!header) return Forward(header);
      const auto [length, kind] = *header;
      const std::uint64_t begin = at + kChunkHeaderBytes;
      if (length > size_ - begin) {
        return Corrupt(at, "the chunk says " + std::to_string(length) + " bytes, " +
                               std::to_string(size_ - begin) + " follow");
      }
      if ((number == 0) != (kind == kJsonChunk)) {
        return Corrupt(at + 4, number == 0 ? "expected the first chunk to be JSON"
                                           : "found a second JSON chunk");
      }
      if (number == 0) {
        if (auto ok = ReadJson(begin, length); !ok) return ok;
      } else if (kind == kBinaryChunk && number == 1) {
        container_.chunk = {begin, length};
      } else if (kind == kBinaryChunk) {
        return Corrupt(at + 4, "found a binary chunk that is not the second");
      }
      at = begin + length;
    }
    if (container_.json.root.is_null()) return Corrupt(at, "expected a JSON chunk");
    return {};
  }

  Result<void> ReadJson(std::uint64_t at, std::uint64_t length) {
    MemoryShare share;
    if (options_.memory != nullptr) {
      auto taken = options_.memory->Take(length, source_.name() + ": the JSON text");
      if (!taken) return Forward(taken);
      share = std::move(*taken);
    }
    std::string text(static_cast<std::size_t>(length), '\0');
    if (auto ok = source_.ReadAt(at, text); !ok) return ok;
    auto json = ParseJson(text, source_.name(), at, options_.memory);
    if (!json) return Forward(json);
    container_.json = std::move(*json);
    return {};
  }

  GltfContainer& container_;
  ByteSource& source_;
  std::uint64_t size_;
  const OpenOptions& options_;
};

}  // namespace

Result<GltfContainer> OpenGltfContainer(std::unique_ptr<ByteSource> source,
                                        const OpenOptions& options) {
  auto readable = WithReadAt(std::move(source), options.scratch);
  if (!readable) return Forward(readable);
  GltfContainer container;
  container.owned = std::move(*readable);
  container.source = container.owned.get();
  if (auto ok = Opener(container, options).Open(); !ok) return Forward(ok);
  return container;
}

}  // namespace strata::io
