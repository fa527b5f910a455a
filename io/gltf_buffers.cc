#include "io/gltf_buffers.h"

#include <meshoptimizer.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include "io/companion_file.h"

namespace strata::io {
namespace {

// A part of something larger, which it keeps alive.
class PartOf : public GltfBytes {
 public:
  PartOf(std::shared_ptr<GltfBytes> whole, std::uint64_t offset, std::uint64_t size)
      : whole_(std::move(whole)), offset_(offset), size_(size) {}
  std::uint64_t size() const override { return size_; }
  Result<void> Read(std::uint64_t offset, std::span<char> out) override {
    return whole_->Read(offset_ + offset, out);
  }

 private:
  std::shared_ptr<GltfBytes> whole_;
  std::uint64_t offset_, size_;
};

class FileBytes : public GltfBytes {
 public:
  explicit FileBytes(std::unique_ptr<ByteSource> source) : source_(std::move(source)) {}
  std::uint64_t size() const override { return source_->size().value_or(0); }
  Result<void> Read(std::uint64_t offset, std::span<char> out) override {
    return source_->ReadAt(offset, out);
  }

 private:
  std::unique_ptr<ByteSource> source_;
};

// The chunk of a GLB, whose source somebody else owns.
class ChunkBytes : public GltfBytes {
 public:
  ChunkBytes(ByteSource& source, GltfContainer::Chunk chunk) : source_(source), chunk_(chunk) {}
  std::uint64_t size() const override { return chunk_.size; }
  Result<void> Read(std::uint64_t offset, std::span<char> out) override {
    return source_.ReadAt(chunk_.offset + offset, out);
  }

 private:
  ByteSource& source_;
  GltfContainer::Chunk chunk_;
};

class DecodedBytes : public GltfBytes {
 public:
  DecodedBytes(std::vector<char> bytes, MemoryShare share)
      : bytes_(std::move(bytes)), share_(std::move(share)) {}
  std::uint64_t size() const override { return bytes_.size(); }
  Result<void> Read(std::uint64_t offset, std::span<char> out) override {
    if (!out.empty()) std::memcpy(out.data(), bytes_.data() + offset, out.size());
    return {};
  }

 private:
  std::vector<char> bytes_;
  MemoryShare share_;
};

constexpr std::uint8_t kNoDigit = 64;

constexpr std::array<std::uint8_t, 256> MakeDigits() {
  std::array<std::uint8_t, 256> digits{};
  digits.fill(kNoDigit);
  constexpr std::string_view kAlphabet =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  for (std::size_t i = 0; i < kAlphabet.size(); ++i) {
    digits[static_cast<unsigned char>(kAlphabet[i])] = static_cast<std::uint8_t>(i);
  }
  return digits;
}
constexpr std::array<std::uint8_t, 256> kDigits = MakeDigits();

// Base64 text, decoded where it is read. Precondition: IsBase64, without padding.
class Base64Bytes : public GltfBytes {
 public:
  explicit Base64Bytes(std::string_view digits) : digits_(digits) {}
  std::uint64_t size() const override {
    return digits_.size() / 4 * 3 + (digits_.size() % 4 == 0 ? 0 : digits_.size() % 4 - 1);
  }
  Result<void> Read(std::uint64_t offset, std::span<char> out) override {
    for (char& c : out) c = At(offset++);
    return {};
  }

 private:
  unsigned Digit(std::uint64_t i) const {
    return i < digits_.size() ? kDigits[static_cast<unsigned char>(digits_[i])] : 0;
  }
  char At(std::uint64_t i) const {
    const std::uint64_t digit = i / 3 * 4 + i % 3;
    const unsigned left = static_cast<unsigned>(i % 3) * 2 + 2;
    return static_cast<char>((Digit(digit) << left | Digit(digit + 1) >> (6 - left)) & 255);
  }
  std::string_view digits_;
};

// Digits alone, and not one too many.
bool IsBase64(std::string_view digits) {
  return digits.size() % 4 != 1 && std::all_of(digits.begin(), digits.end(), [](char c) {
           return kDigits[static_cast<unsigned char>(c)] != kNoDigit;
         });
}

int DecodeMeshopt(const GltfMeshopt& meshopt, const std::vector<char>& packed, char* to) {
  const auto* const from = reinterpret_cast<const unsigned char*>(packed.data());
  const auto count = static_cast<std::size_t>(meshopt.count);
  switch (meshopt.mode) {
    case GltfMeshopt::Mode::kAttributes:
      return meshopt_decodeVertexBuffer(to, count, meshopt.stride, from, packed.size());
    case GltfMeshopt::Mode::kTriangles:
      return meshopt_decodeIndexBuffer(to, count, meshopt.stride, from, packed.size());
    case GltfMeshopt::Mode::kIndices:
      return meshopt_decodeIndexSequence(to, count, meshopt.stride, from, packed.size());
  }
  return -1;
}

void ApplyFilter(const GltfMeshopt& meshopt, char* values) {
  const auto count = static_cast<std::size_t>(meshopt.count);
  switch (meshopt.filter) {
    case GltfMeshopt::Filter::kNone:
      return;
    case GltfMeshopt::Filter::kOctahedral:
      return meshopt_decodeFilterOct(values, count, meshopt.stride);
    case GltfMeshopt::Filter::kQuaternion:
      return meshopt_decodeFilterQuat(values, count, meshopt.stride);
    case GltfMeshopt::Filter::kExponential:
      return meshopt_decodeFilterExp(values, count, meshopt.stride);
  }
}

// The most that so many packed bytes can hold. Attributes: 64 bytes that do not change take one
// byte of header's quarter; indices: a byte or more for a triangle.
std::uint64_t MostDecoded(const GltfMeshopt& meshopt) {
  const std::uint64_t ratio = meshopt.mode == GltfMeshopt::Mode::kAttributes ? 64 : 12;
  return (meshopt.length + 64) * ratio;
}

}  // namespace

Result<MemoryShare> GltfBuffers::Take(std::uint64_t bytes, const std::string& who) {
  if (options_.memory == nullptr) return MemoryShare();
  if (options_.memory->left() < bytes) Trim();
  return options_.memory->Take(bytes, who);
}

void GltfBuffers::Trim() {
  std::erase_if(decoded_, [](const auto& entry) { return entry.second.use_count() == 1; });
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::View(std::uint32_t index) {
  const GltfView& view = document_.views[index];
  if (!view.meshopt) {
    return Part(view.buffer, view.offset, view.length, "/bufferViews/" + std::to_string(index));
  }
  const auto found = decoded_.find(index);
  if (found != decoded_.end()) return found->second;
  auto decoded = Decode(index);
  if (decoded) decoded_[index] = *decoded;
  return decoded;
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::Part(std::uint32_t index, std::uint64_t offset,
                                                     std::uint64_t length, const std::string& who) {
  auto buffer = Buffer(index);
  if (!buffer) return Forward(buffer);
  const std::uint64_t size = std::min((*buffer)->size(), document_.buffers[index].length);
  if (offset > size || length > size - offset) {
    return Fail(ErrorCode::kCorruptInput,
                name() + ": " + who + ": bytes " + std::to_string(offset) + " to " +
                    std::to_string(offset + length) + " of buffer " + std::to_string(index) +
                    ", which has " + std::to_string(size));
  }
  return std::make_shared<PartOf>(*buffer, offset, length);
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::Buffer(std::uint32_t index) {
  const auto found = buffers_.find(index);
  if (found != buffers_.end()) return found->second;
  auto opened = OpenBuffer(index);
  if (opened) buffers_[index] = *opened;
  return opened;
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::OpenBuffer(std::uint32_t index) {
  const std::string who = name() + ": /buffers/" + std::to_string(index);
  if (document_.buffers[index].has_uri) {
    const nlohmann::json& uri = container_.json.root["buffers"][index]["uri"];
    if (!uri.is_string()) return Fail(ErrorCode::kCorruptInput, who + "/uri: expected a string");
    return OpenUri(uri.get_ref<const std::string&>(), who + "/uri");
  }
  if (index == 0 && container_.chunk) {
    return std::make_shared<ChunkBytes>(*container_.source, *container_.chunk);
  }
  return Fail(ErrorCode::kCorruptInput,
              who + ": has no uri, and the file no binary chunk for it; expected bytes");
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::OpenUri(const std::string& uri,
                                                        const std::string& who) {
  if (!uri.starts_with("data:")) {
    auto path = RelativePath(uri, who);
    if (!path) return Forward(path);
    auto file = OpenCompanion(options_.companions, *path, who);
    if (!file) return Forward(file);
    return std::make_shared<FileBytes>(std::move(*file));
  }
  const std::size_t comma = uri.find(',');
  std::string_view digits = std::string_view(uri).substr(comma == uri.npos ? 0 : comma + 1);
  const bool base64 =
      comma != uri.npos && std::string_view(uri).substr(0, comma).ends_with(";base64");
  for (int pad = 0; pad < 2 && digits.ends_with('='); ++pad) digits.remove_suffix(1);
  if (!base64 || !IsBase64(digits)) {
    return Fail(ErrorCode::kCorruptInput, who + ": expected data:…;base64, and base64 digits");
  }
  return std::make_shared<Base64Bytes>(digits);
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::Image(std::uint32_t index) {
  const std::string who = name() + ": /images/" + std::to_string(index);
  const nlohmann::json& image = container_.json.root["images"][index];
  const auto uri = image.find("uri"), view = image.find("bufferView");
  if (uri != image.end() && uri->is_string()) {
    return OpenUri(uri->get_ref<const std::string&>(), who + "/uri");
  }
  if (view == image.end() || !view->is_number_unsigned()) {
    return Fail(ErrorCode::kCorruptInput, who + ": expected a uri or a bufferView");
  }
  const auto number = view->get<std::uint64_t>();
  if (number < document_.views.size()) return View(static_cast<std::uint32_t>(number));
  return Fail(ErrorCode::kCorruptInput, who + "/bufferView: found index " + std::to_string(number) +
                                            " of " + std::to_string(document_.views.size()));
}

Result<std::shared_ptr<GltfBytes>> GltfBuffers::Decode(std::uint32_t index) {
  const GltfMeshopt& meshopt = *document_.views[index].meshopt;
  const std::string who = "/bufferViews/" + std::to_string(index) + "/EXT_meshopt_compression";
  auto part = Part(meshopt.buffer, meshopt.offset, meshopt.length, who);
  if (!part) return Forward(part);
  const std::uint64_t size = meshopt.count * meshopt.stride;
  if (size > MostDecoded(meshopt)) {
    return Fail(ErrorCode::kCorruptInput, name() + ": " + who + ": found " +
                                              std::to_string(meshopt.length) +
                                              " bytes, which cannot hold " + std::to_string(size));
  }
  auto share = Take(size + meshopt.length, name() + ": " + who);
  if (!share) return Forward(share);
  std::vector<char> packed(static_cast<std::size_t>(meshopt.length));
  if (auto ok = (*part)->Read(0, packed); !ok) return Forward(ok);
  std::vector<char> values(static_cast<std::size_t>(size));
  if (DecodeMeshopt(meshopt, packed, values.data()) != 0) {
    return Fail(ErrorCode::kCorruptInput, name() + ": " + who + ": the data are damaged");
  }
  ApplyFilter(meshopt, values.data());
  return std::make_shared<DecodedBytes>(std::move(values), std::move(*share));
}

}  // namespace strata::io
