#include "tests/support/make_mesh.h"

#include <algorithm>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <numbers>
#include <string_view>
#include <utility>
#include <vector>

#include "core/mesh_reader.h"
#include "io/byte_source.h"
#include "io/ply_header.h"

namespace strata::test {
namespace {

// A well-mixed function of 64 bits: xor-shifts between multiplications by odd constants.
std::uint64_t Mix(std::uint64_t x) {
  x = (x ^ (x >> 31)) * 0xd6e8feb86659fd93u;
  x = (x ^ (x >> 29)) * 0xa0761d6478bd642fu;
  return x ^ (x >> 32);
}

double Wave(double x, double y, double z, int octave, std::uint64_t seed) {
  const auto phase = [&](std::uint64_t k) {
    return static_cast<double>(Mix(seed + 16 * static_cast<std::uint64_t>(octave) + k) >> 40);
  };
  const double f = 3 * std::exp2(octave);
  return std::sin(f * x + phase(0)) * std::sin(f * y + phase(1)) * std::sin(f * z + phase(2));
}

std::array<float, 3> SpherePoint(double theta, double phi, std::uint64_t seed) {
  const double x = std::sin(theta) * std::cos(phi), y = std::sin(theta) * std::sin(phi);
  const double z = std::cos(theta);
  double r = 1;
  for (int octave = 0; octave < 6; ++octave) {
    r += 0.12 * std::exp2(-octave) * Wave(x, y, z, octave, seed);
  }
  return {static_cast<float>(r * x), static_cast<float>(r * y), static_cast<float>(r * z)};
}

// A file that is written through a buffer.
class Out {
 public:
  explicit Out(const std::string& path) : path_(path), file_(std::fopen(path.c_str(), "wb")) {
    buffer_.reserve(kBytes + 256);
  }
  ~Out() {
    if (file_ != nullptr) std::fclose(file_);
  }
  Out(const Out&) = delete;
  Out& operator=(const Out&) = delete;

  void Text(std::string_view text) { Bytes(text.data(), text.size()); }
  template <class T>
  void Value(T value) {
    Bytes(reinterpret_cast<const char*>(&value), sizeof value);
  }
  template <class... Args>
  void Format(const char* format, Args... args) {
    char line[192];
    const int n = std::snprintf(line, sizeof line, format, args...);
    Bytes(line, static_cast<std::size_t>(n));
  }
  Result<void> Close() {
    Flush();
    const bool closed = file_ != nullptr && std::fclose(std::exchange(file_, nullptr)) == 0;
    if (!closed || failed_) return Fail(ErrorCode::kIo, path_ + ": cannot be written");
    return {};
  }

 private:
  static constexpr std::size_t kBytes = std::size_t{1} << 22;
  void Bytes(const char* bytes, std::size_t n) {
    buffer_.insert(buffer_.end(), bytes, bytes + n);
    if (buffer_.size() >= kBytes) Flush();
  }
  void Flush() {
    failed_ |=
        file_ == nullptr || std::fwrite(buffer_.data(), 1, buffer_.size(), file_) != buffer_.size();
    buffer_.clear();
  }

  std::string path_;
  std::FILE* file_;
  std::vector<char> buffer_;
  bool failed_ = false;
};

void WritePly(const ComputedMesh& mesh, bool ascii, Out& out) {
  out.Format("ply\nformat %s 1.0\nelement vertex %llu\n", ascii ? "ascii" : "binary_little_endian",
             static_cast<unsigned long long>(mesh.vertices));
  out.Format("property float x\nproperty float y\nproperty float z\nelement face %llu\n",
             static_cast<unsigned long long>(mesh.triangles));
  out.Text("property list uchar uint vertex_indices\nend_header\n");
  for (std::uint64_t i = 0; i < mesh.vertices; ++i) {
    const auto [x, y, z] = mesh.vertex(i);
    if (ascii) {
      out.Format("%.9g %.9g %.9g\n", x, y, z);
    } else {
      out.Value(x), out.Value(y), out.Value(z);
    }
  }
  for (std::uint64_t i = 0; i < mesh.triangles; ++i) {
    const auto corners = mesh.triangle(i);
    if (ascii) {
      out.Format("3 %llu %llu %llu\n", static_cast<unsigned long long>(corners[0]),
                 static_cast<unsigned long long>(corners[1]),
                 static_cast<unsigned long long>(corners[2]));
      continue;
    }
    out.Value(std::uint8_t{3});
    for (const std::uint64_t c : corners) out.Value(static_cast<std::uint32_t>(c));
  }
}

void WriteObj(const ComputedMesh& mesh, Out& out) {
  for (std::uint64_t i = 0; i < mesh.vertices; ++i) {
    const auto [x, y, z] = mesh.vertex(i);
    out.Format("v %.9g %.9g %.9g\n", x, y, z);
  }
  for (std::uint64_t i = 0; i < mesh.triangles; ++i) {
    const auto [a, b, c] = mesh.triangle(i);
    out.Format("f %llu %llu %llu\n", static_cast<unsigned long long>(a + 1),
               static_cast<unsigned long long>(b + 1), static_cast<unsigned long long>(c + 1));
  }
}

void WriteStl(const ComputedMesh& mesh, Out& out) {
  std::array<char, 80> header{};
  std::memcpy(header.data(), "made", 4);
  out.Text({header.data(), header.size()});
  out.Value(static_cast<std::uint32_t>(mesh.triangles));
  for (std::uint64_t i = 0; i < mesh.triangles; ++i) {
    for (int k = 0; k < 3; ++k) out.Value(0.0f);
    for (const std::uint64_t corner : mesh.triangle(i)) {
      for (const float value : mesh.vertex(corner)) out.Value(value);
    }
    out.Value(std::uint16_t{0});
  }
}

struct StoredMesh {
  std::vector<std::array<float, 3>> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

// Fills `out` from the buffer, row by row.
template <class Row, class Take>
Result<void> ReadRows(io::InputBuffer& input, std::uint64_t count, std::size_t stride, Row&& row,
                      Take&& bad) {
  for (std::uint64_t i = 0; i < count; ++i) {
    auto bytes = input.Peek(stride);
    if (!bytes) return Forward(bytes);
    if (bytes->size() < stride || !row(bytes->data())) return bad();
    input.Consume(stride);
  }
  return {};
}

}  // namespace

Permutation::Permutation(std::uint64_t n, std::uint64_t seed) : n_(n) {
  while (half_bits_ < 31 && (std::uint64_t{1} << (2 * half_bits_)) < n) ++half_bits_;
  half_mask_ = (std::uint64_t{1} << half_bits_) - 1;
  for (std::size_t r = 0; r < keys_.size(); ++r) keys_[r] = Mix(seed * keys_.size() + r + 1);
}

std::uint64_t Permutation::Round(int round, std::uint64_t half) const {
  return Mix(half ^ keys_[static_cast<std::size_t>(round)]) & half_mask_;
}

std::uint64_t Permutation::operator()(std::uint64_t i) const {
  do {
    std::uint64_t left = i >> half_bits_, right = i & half_mask_;
    for (int r = 0; r < kRounds; ++r) {
      left ^= Round(r, right);
      std::swap(left, right);
    }
    i = left << half_bits_ | right;
  } while (i >= n_);
  return i;
}

std::uint64_t Permutation::Inverse(std::uint64_t i) const {
  do {
    std::uint64_t left = i >> half_bits_, right = i & half_mask_;
    for (int r = kRounds - 1; r >= 0; --r) {
      std::swap(left, right);
      left ^= Round(r, right);
    }
    i = left << half_bits_ | right;
  } while (i >= n_);
  return i;
}

// Rings of `around` vertices, two triangles for each place between two rings; the outermost rings
// are small circles round the poles, which stay open.
ComputedMesh FractalSphere(std::uint64_t triangles, std::uint64_t seed) {
  const auto rings_apart = static_cast<std::uint64_t>(
      std::max(5.0, std::round(std::sqrt(static_cast<double>(triangles) / 4))));
  const std::uint64_t around =
      std::max<std::uint64_t>(8, (triangles + rings_apart) / (2 * rings_apart));
  ComputedMesh mesh;
  mesh.vertices = (rings_apart + 1) * around;
  mesh.triangles = 2 * rings_apart * around;
  mesh.vertex = [=](std::uint64_t i) {
    const double theta = std::numbers::pi * (static_cast<double>(i / around) + 0.5) /
                         static_cast<double>(rings_apart + 1);
    const double phi =
        2 * std::numbers::pi * static_cast<double>(i % around) / static_cast<double>(around);
    return SpherePoint(theta, phi, seed);
  };
  mesh.triangle = [=](std::uint64_t i) -> std::array<std::uint64_t, 3> {
    const std::uint64_t place = i / 2, ring = place / around, k = place % around;
    const std::uint64_t a = ring * around + k, b = ring * around + (k + 1) % around;
    if (i % 2 == 0) return {a, a + around, b};
    return {b, a + around, b + around};
  };
  return mesh;
}

ComputedMesh Tiled(const ComputedMesh& mesh, std::uint64_t triangles) {
  const std::uint64_t copies = (triangles + mesh.triangles - 1) / mesh.triangles;
  const auto columns =
      static_cast<std::uint64_t>(std::ceil(std::sqrt(static_cast<double>(copies))));
  std::array<float, 3> low{HUGE_VALF, HUGE_VALF, 0}, high{-HUGE_VALF, -HUGE_VALF, 0};
  for (std::uint64_t i = 0; i < mesh.vertices; ++i) {
    const auto v = mesh.vertex(i);
    for (std::size_t a = 0; a < 2; ++a) {
      low[a] = std::min(low[a], v[a]), high[a] = std::max(high[a], v[a]);
    }
  }
  const std::array<float, 2> step{1.1f * (high[0] - low[0]), 1.1f * (high[1] - low[1])};
  ComputedMesh tiled;
  tiled.vertices = copies * mesh.vertices;
  tiled.triangles = triangles;
  tiled.vertex = [&mesh, columns, step](std::uint64_t i) {
    const std::uint64_t copy = i / mesh.vertices;
    auto v = mesh.vertex(i % mesh.vertices);
    v[0] += step[0] * static_cast<float>(copy % columns);
    v[1] += step[1] * static_cast<float>(copy / columns);
    return v;
  };
  tiled.triangle = [&mesh](std::uint64_t i) {
    auto corners = mesh.triangle(i % mesh.triangles);
    for (std::uint64_t& c : corners) c += i / mesh.triangles * mesh.vertices;
    return corners;
  };
  return tiled;
}

ComputedMesh Shuffled(ComputedMesh mesh, std::uint64_t seed) {
  const Permutation moved(mesh.vertices, seed);
  ComputedMesh shuffled = mesh;
  shuffled.vertex = [vertex = mesh.vertex, moved](std::uint64_t i) {
    return vertex(moved.Inverse(i));
  };
  shuffled.triangle = [triangle = mesh.triangle, moved](std::uint64_t i) {
    auto corners = triangle(i);
    for (std::uint64_t& c : corners) c = moved(c);
    return corners;
  };
  return shuffled;
}

ComputedMesh ShuffledFaces(ComputedMesh mesh, std::uint64_t seed) {
  const Permutation moved(mesh.triangles, seed);
  ComputedMesh shuffled = mesh;
  shuffled.triangle = [triangle = mesh.triangle, moved](std::uint64_t i) {
    return triangle(moved(i));
  };
  return shuffled;
}

Result<ComputedMesh> ScanFromPly(const std::string& path) {
  auto source = io::OpenByteSource(path);
  if (!source) return Forward(source);
  io::InputBuffer input(**source);
  auto header = io::ReadPlyHeader(input, 1 << 16);
  if (!header) return Forward(header);
  const auto bad = [&] {
    return Fail(ErrorCode::kUnsupported,
                path +
                    ": expected binary little-endian PLY with rows of float x, y, z and then "
                    "faces that are lists of three, counted by one byte, and nothing else");
  };
  if (header->encoding != io::PlyEncoding::kLittleEndian || header->elements.size() != 2 ||
      header->elements[1].properties.size() != 1) {
    return bad();
  }
  std::size_t stride = 0;
  for (const io::PlyProperty& p : header->elements[0].properties) stride += io::PlySize(p.type);
  auto mesh = std::make_shared<StoredMesh>();
  auto read = ReadRows(
      input, header->elements[0].count, stride,
      [&](const char* row) {
        std::memcpy(mesh->vertices.emplace_back().data(), row, 12);
        return true;
      },
      bad);
  if (!read) return Forward(read);
  read = ReadRows(
      input, header->elements[1].count, 13,
      [&](const char* row) {
        std::memcpy(mesh->triangles.emplace_back().data(), row + 1, 12);
        const auto& t = mesh->triangles.back();
        return *row == 3 && *std::max_element(t.begin(), t.end()) < mesh->vertices.size();
      },
      bad);
  if (!read) return Forward(read);
  ComputedMesh computed;
  computed.vertices = mesh->vertices.size();
  computed.triangles = mesh->triangles.size();
  computed.vertex = [mesh](std::uint64_t i) { return mesh->vertices[i]; };
  computed.triangle = [mesh](std::uint64_t i) -> std::array<std::uint64_t, 3> {
    const auto& t = mesh->triangles[i];
    return {t[0], t[1], t[2]};
  };
  return computed;
}

std::optional<MeshFormat> MeshFormatNamed(const std::string& name) {
  if (name == "ply") return MeshFormat::kPly;
  if (name == "ply-ascii") return MeshFormat::kPlyAscii;
  if (name == "stl") return MeshFormat::kStl;
  if (name == "obj") return MeshFormat::kObj;
  return std::nullopt;
}

Result<void> WriteMesh(const ComputedMesh& mesh, MeshFormat format, const std::string& path) {
  constexpr std::uint64_t kMost = std::uint64_t{1} << 32;
  const bool stl = format == MeshFormat::kStl;
  if (mesh.vertices > kMost || (stl && mesh.triangles >= kMost)) {
    return Fail(ErrorCode::kInvalidArgument, path + ": 32 bits cannot count that many");
  }
  Out out(path);
  if (stl) {
    WriteStl(mesh, out);
  } else if (format == MeshFormat::kObj) {
    WriteObj(mesh, out);
  } else {
    WritePly(mesh, format == MeshFormat::kPlyAscii, out);
  }
  return out.Close();
}

}  // namespace strata::test
