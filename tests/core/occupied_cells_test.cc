// Promise 2: one sample per occupied cell, and a cell is occupied when a piece of positive area
// lies in it. The oracle clips with exact rational numbers.
#include <gtest/gtest.h>

#include <map>
#include <numeric>
#include <set>
#include <string>

#include "core/sample_mesh.h"
#include "core/simd_target.h"
#include "tests/support/memory_mesh.h"

namespace strata::test {
namespace {

__extension__ using Int128 = __int128;

// A rational number; numerators and denominators stay small on the meshes below.
class Rational {
 public:
  Rational(Int128 n = 0, Int128 d = 1) : n_(n), d_(d) { Reduce(); }
  friend Rational operator+(Rational a, Rational b) {
    return {a.n_ * b.d_ + b.n_ * a.d_, a.d_ * b.d_};
  }
  friend Rational operator-(Rational a, Rational b) {
    return {a.n_ * b.d_ - b.n_ * a.d_, a.d_ * b.d_};
  }
  friend Rational operator*(Rational a, Rational b) { return {a.n_ * b.n_, a.d_ * b.d_}; }
  friend Rational operator/(Rational a, Rational b) { return {a.n_ * b.d_, a.d_ * b.n_}; }
  int sign() const { return n_ > 0 ? 1 : n_ < 0 ? -1 : 0; }
  std::int32_t Floor() const {
    const Int128 q = n_ / d_;
    return static_cast<std::int32_t>(q - (n_ % d_ < 0 ? 1 : 0));
  }

 private:
  void Reduce() {
    if (d_ < 0) n_ = -n_, d_ = -d_;
    Int128 a = n_ < 0 ? -n_ : n_, b = d_;
    while (b != 0) {
      const Int128 r = a % b;
      a = b;
      b = r;
    }
    if (a > 1) n_ /= a, d_ /= a;
  }
  Int128 n_, d_;
};

using Point = std::array<Rational, 3>;
using Exact = std::vector<Point>;

// The part of a convex polygon on one side of `axis = plane`.
Exact Half(const Exact& in, std::size_t axis, int plane, int side) {
  Exact out;
  for (std::size_t i = 0; i < in.size(); ++i) {
    const Point &a = in[i], &b = in[(i + 1) % in.size()];
    const Rational da = Rational(side) * (a[axis] - Rational(plane));
    const Rational db = Rational(side) * (b[axis] - Rational(plane));
    if (da.sign() >= 0) out.push_back(a);
    if (da.sign() * db.sign() >= 0) continue;
    const Rational t = da / (da - db);
    Point p;
    for (std::size_t k = 0; k < 3; ++k) p[k] = a[k] + t * (b[k] - a[k]);
    out.push_back(p);
  }
  return out;
}

bool HasArea(const Exact& p) {
  for (std::size_t i = 1; i + 1 < p.size(); ++i) {
    Point u, v;
    for (std::size_t k = 0; k < 3; ++k) u[k] = p[i][k] - p[0][k], v[k] = p[i + 1][k] - p[0][k];
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t l = (k + 1) % 3, m = (k + 2) % 3;
      if ((u[l] * v[m] - u[m] * v[l]).sign() != 0) return true;
    }
  }
  return false;
}

// Half-open cells: a flat polygon in the plane between two cells belongs to the upper one, so a
// cell takes it only from its own lower side.
bool LiesOnUpperSide(const Exact& p, std::size_t axis, int plane) {
  for (const Point& c : p) {
    if ((c[axis] - Rational(plane)).sign() != 0) return false;
  }
  return true;
}

// Calls `visit` with every cell in which `whole` has a piece of positive area.
template <class F>
void ForEachPiece(const Exact& whole, F&& visit) {
  std::int32_t low[3], high[3];
  for (std::size_t a = 0; a < 3; ++a) {
    low[a] = high[a] = whole[0][a].Floor();
    for (const Point& c : whole) {
      low[a] = std::min(low[a], c[a].Floor());
      high[a] = std::max(high[a], c[a].Floor());
    }
  }
  const auto slab = [](const Exact& p, std::size_t axis, int i) {
    Exact part = Half(Half(p, axis, i, 1), axis, i + 1, -1);
    if (part.size() < 3 || LiesOnUpperSide(part, axis, i + 1)) part.clear();
    return part;
  };
  for (std::int32_t x = low[0]; x <= high[0]; ++x) {
    const Exact in_x = slab(whole, 0, x);
    for (std::int32_t y = low[1]; y <= high[1] && !in_x.empty(); ++y) {
      const Exact in_y = slab(in_x, 1, y);
      for (std::int32_t z = low[2]; z <= high[2] && !in_y.empty(); ++z) {
        const Exact piece = slab(in_y, 2, z);
        if (!piece.empty() && HasArea(piece)) visit(Cell{x, y, z});
      }
    }
  }
}

struct Oracle {
  std::set<Cell> cells;
  std::uint64_t pieces = 0;
};
Oracle CellsOf(const Triangles& mesh, int parts) {
  Oracle oracle;
  for (const Triangle& t : mesh) {
    Exact p;
    for (const Vec3& c : t) {
      Point q;
      for (int a = 0; a < 3; ++a) {
        q[static_cast<std::size_t>(a)] = Rational(static_cast<Int128>(c[a] * parts), parts);
      }
      p.push_back(q);
    }
    ForEachPiece(p, [&](Cell cell) {
      oracle.cells.insert(cell);
      ++oracle.pieces;
    });
  }
  return oracle;
}

// Random triangles with corners on multiples of 1/parts.
Triangles SoupOnGrid(int triangles, int parts, double least, double most, std::uint64_t seed) {
  TestRandom random(seed);
  Triangles mesh;
  for (int i = 0; i < triangles; ++i) {
    const Vec3 at = random.InBox({-6, -6, -6}, {6, 6, 6});
    const double size = random.LogIn(least, most);
    Triangle t;
    for (Vec3& c : t) {
      c = at + random.Direction() * (size * random.In(0.3, 1));
      for (int a = 0; a < 3; ++a) c[a] = std::round(c[a] * parts) / parts;
    }
    mesh.push_back(t);
  }
  return mesh;
}

// Leaves out triangles without area, which are skipped, and copies, which are pieces again.
Triangles Usable(const Triangles& mesh) {
  Triangles usable;
  for (const Triangle& t : mesh) {
    if (Norm2(Cross(t[1] - t[0], t[2] - t[0])) > 0) usable.push_back(t);
  }
  return usable;
}

void ExpectOraclesCells(const Triangles& mesh, int parts) {
  const Oracle oracle = CellsOf(mesh, parts);
  SampleOptions options;
  options.lattice = VoxelSize{1};
  options.min_distance = 0;
  options.attributes = kCell;
  MemoryMesh reader(mesh);
  RunContext context;
  const auto result = SampleMesh(reader, options, context);
  ASSERT_TRUE(result) << result.error().message;
  std::set<Cell> cells(result->samples.cell.begin(), result->samples.cell.end());
  EXPECT_EQ(cells.size(), result->samples.size()) << "a cell has two samples";
  for (const Cell c : cells) {
    EXPECT_TRUE(oracle.cells.contains(c)) << c.x << ' ' << c.y << ' ' << c.z << " has no surface";
  }
  for (const Cell c : oracle.cells) {
    EXPECT_TRUE(cells.contains(c)) << c.x << ' ' << c.y << ' ' << c.z << " got no sample";
  }
  EXPECT_EQ(result->stats.cells, oracle.cells.size());
  EXPECT_EQ(result->stats.pieces, oracle.pieces);
  // A sample lies in its cell, but for the last bits.
  for (std::size_t i = 0; i < result->samples.size(); ++i) {
    const Cell c = result->samples.cell[i];
    const Vec3 local = result->samples.position[i] - Vec3{double(c.x), double(c.y), double(c.z)};
    for (int a = 0; a < 3; ++a) {
      EXPECT_GE(local[a], -1e-14);
      EXPECT_LE(local[a], 1 + 1e-14);
    }
  }
}

class Promise2OnePerOccupiedCell : public testing::Test {
 protected:
  void TearDown() override { ASSERT_TRUE(ForceSimdTarget("auto")); }
};

TEST_F(Promise2OnePerOccupiedCell, EqualsTheExactOracleOnTriangleSoup) {
  for (const std::string& target : SimdTargets()) {
    ASSERT_TRUE(ForceSimdTarget(target));
    for (const int parts : {1, 2, 8, 64}) {
      SCOPED_TRACE(target + ", corners on multiples of 1/" + std::to_string(parts));
      ExpectOraclesCells(Usable(SoupOnGrid(300, parts, 0.3, 1.5, 71)), parts);
      ExpectOraclesCells(Usable(SoupOnGrid(60, parts, 1, 8, 72)), parts);
    }
  }
}

// Each alone, so that no triangle covers for another's mistake.
TEST_F(Promise2OnePerOccupiedCell, EqualsTheExactOracleOnSingleTriangles) {
  for (const int parts : {1, 2, 8}) {
    for (const Triangle& t : Usable(SoupOnGrid(300, parts, 0.5, 4, 73))) {
      SCOPED_TRACE("corners on multiples of 1/" + std::to_string(parts));
      ExpectOraclesCells({t}, parts);
      if (HasFailure()) return;
    }
  }
}

TEST_F(Promise2OnePerOccupiedCell, FlatFacesBelongToTheUpperCell) {
  ExpectOraclesCells(BoxMesh({-2, -1, 0}, {3, 1, 2}), 1);
  Triangles floor;
  AddQuad(floor, {0, 0, 5}, {4, 0, 0}, {0, 4, 0});
  ExpectOraclesCells(floor, 1);
}

TEST_F(Promise2OnePerOccupiedCell, ATouchWithoutAreaOccupiesNothing) {
  // Corner, edge and side of the neighbours are touched, none is entered.
  ExpectOraclesCells({{Vec3{0, 0, 0}, Vec3{1, 0, 0}, Vec3{0, 1, 1}}}, 1);
  ExpectOraclesCells({{Vec3{0.5, 0.5, 0.5}, Vec3{1, 0.5, 0.5}, Vec3{0.5, 1, 1}}}, 2);
  ExpectOraclesCells({{Vec3{-1, -1, -1}, Vec3{0, 0, 0}, Vec3{-1, 0, -1}}}, 1);
}

}  // namespace
}  // namespace strata::test
