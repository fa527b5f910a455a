// Meshes in memory, as readers: what the core's tests sample.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <random>
#include <vector>

#include "core/mesh_reader.h"

namespace strata::test {

using Triangle = std::array<Vec3, 3>;
using Triangles = std::vector<Triangle>;

/// Gives the triangles of an array, and a vertex list made of their corners (or none, like STL).
/// Owns its mesh. Threads: one at a time.
class MemoryMesh : public MeshReader {
 public:
  enum class Vertices { kNone, kDouble, kFloat };

  explicit MemoryMesh(Triangles triangles, Vertices vertices = Vertices::kDouble)
      : triangles_(std::move(triangles)), carrier_(vertices) {
    info_ = {"memory", "none", "none"};
    if (carrier_ == Vertices::kNone) return;
    for (const Triangle& t : triangles_) {
      for (const Vec3& corner : t) AddVertex(corner);
    }
  }

  /// One more entry of the vertex list, which no triangle names.
  void AddVertex(Vec3 p) {
    for (int a = 0; a < 3; ++a) {
      if (carrier_ == Vertices::kFloat) {
        f32_.push_back(static_cast<float>(p[a]));
      } else {
        f64_.push_back(p[a]);
      }
    }
  }
  /// Called before every Read, with the number of reads so far.
  void set_on_read(std::function<void(std::uint64_t)> on_read) { on_read_ = std::move(on_read); }
  std::uint64_t reads() const { return reads_; }

  const MeshInfo& info() const override { return info_; }
  VertexView vertices() const override { return {f32_, f64_}; }
  Result<std::size_t> Read(TriangleBatch& batch) override {
    if (on_read_) on_read_(reads_);
    ++reads_;
    batch.Clear();
    while (!batch.full() && next_ < triangles_.size()) {
      const Triangle& t = triangles_[next_];
      batch.Push(t[0], t[1], t[2], next_++);
    }
    counts_.triangles = counts_.faces = next_;
    counts_.vertices = vertices().size();
    return batch.size();
  }
  Result<void> Rewind() override {
    next_ = 0;
    counts_.faces = counts_.triangles = 0;
    return {};
  }
  const ReadCounts& counts() const override { return counts_; }
  std::uint64_t bytes_read() const override { return next_; }
  std::optional<std::uint64_t> bytes_total() const override { return triangles_.size(); }

 private:
  Triangles triangles_;
  Vertices carrier_;
  std::vector<float> f32_;
  std::vector<double> f64_;
  MeshInfo info_;
  ReadCounts counts_;
  std::size_t next_ = 0;
  std::uint64_t reads_ = 0;
  std::function<void(std::uint64_t)> on_read_;
};

/// The parallelogram corner, corner + u, corner + u + v, corner + v as two triangles.
inline void AddQuad(Triangles& mesh, Vec3 corner, Vec3 u, Vec3 v) {
  mesh.push_back({corner, corner + u, corner + u + v});
  mesh.push_back({corner, corner + u + v, corner + v});
}

/// The box [low, high]: twelve triangles, counter-clockwise seen from outside.
inline Triangles BoxMesh(Vec3 low, Vec3 high) {
  const Vec3 s = high - low, x{s.x, 0, 0}, y{0, s.y, 0}, z{0, 0, s.z};
  Triangles mesh;
  AddQuad(mesh, low, y, x);
  AddQuad(mesh, low, x, z);
  AddQuad(mesh, low, z, y);
  AddQuad(mesh, low + z, x, y);
  AddQuad(mesh, low + y, z, x);
  AddQuad(mesh, low + x, y, z);
  return mesh;
}

/// Every triangle of a reader.
inline Triangles ReadTriangles(MeshReader& reader) {
  Triangles all;
  TriangleBatch batch(4096);
  for (auto n = reader.Read(batch); n && *n > 0; n = reader.Read(batch)) {
    for (std::size_t i = 0; i < *n; ++i) {
      all.push_back({batch.corner(i, 0), batch.corner(i, 1), batch.corner(i, 2)});
    }
  }
  return all;
}

/// Random numbers for tests: the same on every platform (the standard distributions are not).
class TestRandom {
 public:
  explicit TestRandom(std::uint64_t seed) : engine_(seed) {}
  /// Uniform in [0,1).
  double Unit() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  double In(double low, double high) { return low + (high - low) * Unit(); }
  /// Uniform among 0 … n-1.
  std::size_t Below(std::size_t n) {
    return static_cast<std::size_t>(Unit() * static_cast<double>(n));
  }
  /// low · (high/low)^u.
  double LogIn(double low, double high) { return low * std::pow(high / low, Unit()); }
  Vec3 InBox(Vec3 low, Vec3 high) {
    return {In(low.x, high.x), In(low.y, high.y), In(low.z, high.z)};
  }
  /// Uniform on the unit sphere.
  Vec3 Direction() {
    for (;;) {
      const Vec3 p = InBox({-1, -1, -1}, {1, 1, 1});
      const double n2 = Norm2(p);
      if (n2 > 0.01 && n2 < 1) return p * (1 / std::sqrt(n2));
    }
  }
  std::uint64_t Bits() { return engine_(); }
  template <class T>
  void Shuffle(std::vector<T>& v) {
    for (std::size_t i = v.size(); i > 1; --i) std::swap(v[i - 1], v[Below(i)]);
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace strata::test
