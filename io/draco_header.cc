#include "io/draco_header.h"

#include <algorithm>

namespace strata::io {
namespace {

// A regular grid packs best: 28 faces to a byte were measured, 552 where all positions are rounded
// to the corners of one cube.
constexpr std::uint64_t kMostPerByte = 1024;
constexpr int kMostDepth = 64;

class Scanner {
 public:
  Scanner(std::string_view bytes, const std::string& who) : bytes_(bytes), who_(who) {}

  Result<DracoHeader> Read() {
    constexpr std::size_t kFixed = 11;
    if (!bytes_.starts_with("DRACO") || bytes_.size() < kFixed) {
      return Fail(ErrorCode::kCorruptInput,
                  who_ + ": byte 0: expected the header of Draco data, found " +
                      std::to_string(bytes_.size()) + " bytes that are none");
    }
    const unsigned major = At(5), minor = At(6), type = At(7), method = At(8);
    const unsigned flags = At(9) | At(10) << 8;
    version_ = major << 8 | minor;
    if (version_ > 0x202 || version_ < 0x100) {
      return Fail(ErrorCode::kUnsupported, who_ + ": byte 5: found Draco version " +
                                               std::to_string(major) + '.' + std::to_string(minor) +
                                               ", expected 1.0 to 2.2");
    }
    if (type == 0) {
      return Fail(
          ErrorCode::kUnsupported,
          who_ + ": byte 7: found a Draco point cloud, which has no surface; expected a mesh");
    }
    if (type != 1 || method > 1) return Damaged("expected a mesh of a known encoding");
    at_ = kFixed;
    if (version_ >= 0x103 && (flags & 0x8000) != 0 && !SkipAllMetadata()) {
      return Damaged("the metadata are damaged");
    }
    DracoHeader header;
    header.edgebreaker = method == 1;
    if (!(header.edgebreaker ? ReadEdgebreaker(header) : ReadSequential(header))) {
      return Damaged("the data end in their head");
    }
    return Judge(header);
  }

 private:
  unsigned At(std::size_t i) const { return static_cast<unsigned char>(bytes_[i]); }
  tl::unexpected<Error> Damaged(const char* what) const {
    return Fail(
        ErrorCode::kCorruptInput,
        who_ + ": byte " + std::to_string(std::min(at_, bytes_.size())) + ": Draco: " + what);
  }

  Result<DracoHeader> Judge(const DracoHeader& header) const {
    const std::uint64_t most = bytes_.size() * kMostPerByte;
    if (header.faces > most || header.points > most) {
      return Fail(ErrorCode::kCorruptInput, who_ + ": Draco: " + std::to_string(bytes_.size()) +
                                                " bytes cannot hold " +
                                                std::to_string(header.faces) + " faces and " +
                                                std::to_string(header.points) + " points");
    }
    return header;
  }

  bool Skip(std::uint64_t n) {
    if (n > bytes_.size() - at_) return false;
    at_ += static_cast<std::size_t>(n);
    return true;
  }
  bool Byte(std::uint64_t& value) {
    if (at_ >= bytes_.size()) return false;
    value = At(at_++);
    return true;
  }
  // Seven bits a byte, the lowest first; before 2.0 four plain bytes.
  bool Number(std::uint64_t& value) {
    value = 0;
    std::uint64_t byte = 0;
    for (unsigned shift = 0; shift < 32 + 7; shift += version_ < 0x200 ? 8 : 7) {
      if (!Byte(byte)) return false;
      if (version_ < 0x200) {
        value |= byte << shift;
        if (shift == 24) return true;
        continue;
      }
      value |= (byte & 127) << shift;
      if (byte < 128) return true;
    }
    return false;
  }
  bool Varint(std::uint64_t& value) {
    value = 0;
    std::uint64_t byte = 0;
    for (unsigned shift = 0; shift < 32 + 7; shift += 7) {
      if (!Byte(byte)) return false;
      value |= (byte & 127) << shift;
      if (byte < 128) return true;
    }
    return false;
  }

  bool ReadEdgebreaker(DracoHeader& header) {
    std::uint64_t ignored = 0;
    if (!Byte(ignored)) return false;                        // How it was traversed.
    if (version_ < 0x202 && !Number(ignored)) return false;  // New vertices.
    std::uint64_t symbols = 0, splits = 0;
    if (!Number(header.points) || !Number(header.faces) || !Byte(header.attributes) ||
        !Number(symbols) || !Number(splits)) {
      return false;
    }
    header.points += splits;
    return true;
  }
  bool ReadSequential(DracoHeader& header) {
    const bool plain = version_ < 0x202;
    return plain ? Fixed(header.faces) && Fixed(header.points)
                 : Varint(header.faces) && Varint(header.points);
  }
  bool Fixed(std::uint64_t& value) {
    value = 0;
    std::uint64_t byte = 0;
    for (unsigned shift = 0; shift < 32; shift += 8) {
      if (!Byte(byte)) return false;
      value |= byte << shift;
    }
    return true;
  }

  bool SkipAllMetadata() {
    std::uint64_t attributes = 0, id = 0;
    if (!Varint(attributes)) return false;
    for (std::uint64_t i = 0; i < attributes; ++i) {
      if (!Varint(id) || !SkipMetadata(0)) return false;
    }
    return SkipMetadata(0);
  }
  bool SkipName() {
    std::uint64_t length = 0;
    return Byte(length) && Skip(length);
  }
  bool SkipMetadata(int depth) {
    std::uint64_t entries = 0, parts = 0, length = 0;
    if (depth > kMostDepth || !Varint(entries)) return false;
    for (std::uint64_t i = 0; i < entries; ++i) {
      if (!SkipName() || !Varint(length) || !Skip(length)) return false;
    }
    if (!Varint(parts)) return false;
    for (std::uint64_t i = 0; i < parts; ++i) {
      if (!SkipName() || !SkipMetadata(depth + 1)) return false;
    }
    return true;
  }

  std::string_view bytes_;
  const std::string& who_;
  std::size_t at_ = 0;
  unsigned version_ = 0;
};

}  // namespace

Result<DracoHeader> ReadDracoHeader(std::string_view bytes, const std::string& who) {
  return Scanner(bytes, who).Read();
}

std::uint64_t DracoDecodeBytes(const DracoHeader& header) {
  // Faces: corner table, its opposites, attribute seams, the faces themselves. Points: positions,
  // normals, colours, texture coordinates, each as integers and as values.
  constexpr std::uint64_t kPerFace = 96, kPerSeam = 48, kPerPoint = 128, kFixed = 1 << 16;
  return header.faces * (kPerFace + kPerSeam * header.attributes) + header.points * kPerPoint +
         kFixed;
}

}  // namespace strata::io
