#include "tests/core/law_cases.h"

#include <gtest/gtest.h>

#include <cmath>

namespace strata::test {
namespace {

// Coordinates are multiples of this, so that copies shifted by whole cells are exact.
constexpr double kGrid = 0x1p-20;
double OnGrid(double v) { return std::floor(v / kGrid + 0.5) * kGrid; }
Vec3 OnGrid(Vec3 p) { return {OnGrid(p.x), OnGrid(p.y), OnGrid(p.z)}; }

int Modulo(int a, int b) { return ((a % b) + b) % b; }

LawCase CentrePlane(std::string name, int n) {
  LawCase c;
  c.name = std::move(name);
  c.representative = [n](Cell cell) -> std::optional<Cell> {
    if (cell.x < 0 || cell.y < 0 || cell.x >= n || cell.y >= n) return std::nullopt;
    return Cell{0, 0, cell.z};
  };
  AddQuad(c.model, {-1, -1, 0.5}, {3, 0, 0}, {0, 3, 0});
  return c;
}

double ObliqueHeight(double x, double y) { return 0.625 * x + 0.375 * y + 0.3125; }
Vec3 OnOblique(double x, double y) { return {x, y, ObliqueHeight(x, y)}; }

LawCase Oblique(std::string name, int n) {
  LawCase c;
  c.name = std::move(name);
  c.representative = [n](Cell cell) -> std::optional<Cell> {
    if (cell.x < 0 || cell.y < 0 || cell.x >= n || cell.y >= n) return std::nullopt;
    const int key = 8 * cell.z - 5 * cell.x - 3 * cell.y;
    // The first column of a row that has the same height over the plane.
    for (int x = 0; x < 8; ++x) {
      if (Modulo(key + 5 * x, 8) == 0) return Cell{x, 0, (key + 5 * x) / 8};
    }
    return std::nullopt;
  };
  c.model.push_back({OnOblique(-40, -40), OnOblique(80, -40), OnOblique(-40, 80)});
  return c;
}

// `tile` copied n^3 times, `period` cells apart.
LawCase Copies(std::string name, const Triangles& tile, int period, int n) {
  LawCase c;
  c.name = std::move(name);
  c.model = tile;
  for (int i = 0; i < n * n * n; ++i) {
    const Vec3 shift = Vec3{double(i % n), double(i / n % n), double(i / n / n)} * period;
    for (const Triangle& t : tile) c.mesh.push_back({t[0] + shift, t[1] + shift, t[2] + shift});
  }
  c.representative = [period](Cell cell) -> std::optional<Cell> {
    return Cell{Modulo(cell.x, period), Modulo(cell.y, period), Modulo(cell.z, period)};
  };
  return c;
}

// Mostly wide, some very narrow.
std::vector<double> RandomBorders(double low, double high, double least, double most,
                                  TestRandom& random) {
  std::vector<double> borders{low};
  while (borders.back() < high) {
    const double u = random.Unit();
    const double width = most * std::pow(least / most, u * u * u);
    borders.push_back(OnGrid(borders.back() + std::max(width, kGrid)));
  }
  borders.back() = high;
  return borders;
}

}  // namespace

LawCase PlaneThroughCentres(int n) {
  LawCase c = CentrePlane("plane through the centres", n);
  AddQuad(c.mesh, {0, 0, 0.5}, {double(n), 0, 0}, {0, double(n), 0});
  return c;
}

LawCase ObliquePlane(int n) {
  LawCase c = Oblique("oblique plane", n);
  const double s = n + 2;
  AddQuad(c.mesh, OnOblique(-1, -1), {s, 0, 0.625 * s}, {0, s, 0.375 * s});
  return c;
}

LawCase FanOfSlivers(int n) {
  LawCase c = CentrePlane("plane in a fan of slivers", n);
  const Vec3 apex{0.37 * n, 0.41 * n, 0.5};
  TestRandom random(11);
  std::vector<Vec3> rim;
  const double side = n;
  const Vec3 corner[4] = {{0, 0, 0.5}, {side, 0, 0.5}, {side, side, 0.5}, {0, side, 0.5}};
  for (int k = 0; k < 4; ++k) {
    const auto at = RandomBorders(0, side, 0.0005 * n, 0.01 * n, random);
    const Vec3 along = (corner[(k + 1) % 4] - corner[k]) * (1 / side);
    for (std::size_t i = 0; i + 1 < at.size(); ++i) rim.push_back(corner[k] + along * at[i]);
  }
  for (std::size_t i = 0; i < rim.size(); ++i) {
    c.mesh.push_back({apex, rim[i], rim[(i + 1) % rim.size()]});
  }
  return c;
}

LawCase StripSlivers(int n) {
  LawCase c = CentrePlane("plane in strips", n);
  TestRandom random(12);
  const auto y = RandomBorders(0, n, 0.001, 1, random);
  for (std::size_t i = 0; i + 1 < y.size(); ++i) {
    AddQuad(c.mesh, {0, y[i], 0.5}, {double(n), 0, 0}, {0, y[i + 1] - y[i], 0});
  }
  return c;
}

LawCase NeedlesInCells(int n) {
  LawCase c = CentrePlane("plane in needles within cells", n);
  TestRandom random(13);
  for (int cell = 0; cell < n * n; ++cell) {
    const Vec3 corner{double(cell % n), double(cell / n), 0.5};
    const auto y = RandomBorders(0, 1, 0x1p-18, 1, random);
    for (std::size_t i = 0; i + 1 < y.size(); ++i) {
      AddQuad(c.mesh, corner + Vec3{0, y[i], 0}, {1, 0, 0}, {0, y[i + 1] - y[i], 0});
    }
  }
  return c;
}

LawCase ObliqueSlivers(int n) {
  LawCase c = Oblique("oblique plane in strips", n);
  TestRandom random(14);
  const auto y = RandomBorders(-1, n + 1, 0.001, 1, random);
  for (std::size_t i = 0; i + 1 < y.size(); ++i) {
    const double s = n + 2, d = y[i + 1] - y[i];
    AddQuad(c.mesh, OnOblique(-1, y[i]), {s, 0, 0.625 * s}, {0, d, 0.375 * d});
  }
  return c;
}

LawCase Corners(int n) {
  Triangles tile;
  const Vec3 right = OnGrid(Vec3{0.3, 0.4, 0.6}), x{1.25, 0, 0}, y{0, 1.25, 0}, z{0, 0, 1.25};
  AddQuad(tile, right, x, y), AddQuad(tile, right, y, z), AddQuad(tile, right, z, x);
  const Vec3 apex = OnGrid(Vec3{2.45, 0.55, 0.35});
  const Vec3 d[3] = {OnGrid(Vec3{0.9, 0.3, 0.6}), OnGrid(Vec3{-0.4, 1.1, 0.3}),
                     OnGrid(Vec3{-0.2, 0.2, 1.3})};
  for (int k = 0; k < 3; ++k) tile.push_back({apex, apex + d[k], apex + d[(k + 1) % 3]});
  return Copies("corners of three planes", tile, 4, n);
}

LawCase Soup(int n) {
  TestRandom random(15);
  Triangles tile;
  for (int i = 0; i < 24; ++i) {
    const double size = random.LogIn(0.01, 1.4);
    const Vec3 at = random.InBox({1.4, 1.4, 1.4}, {2.6, 2.6, 2.6});
    Triangle t;
    for (Vec3& corner : t) corner = OnGrid(at + random.Direction() * (size * random.Unit()));
    tile.push_back(t);
  }
  return Copies("triangle soup", tile, 4, n);
}

std::vector<LawCase> AllLawCases() {
  return {PlaneThroughCentres(200), ObliquePlane(150),   FanOfSlivers(250), StripSlivers(250),
          NeedlesInCells(100),      ObliqueSlivers(100), Corners(14),       Soup(9)};
}

LawTable::LawTable(const LawCase& law_case, double lambda, int per_axis)
    : case_(law_case), lambda_(lambda), per_axis_(per_axis) {}

LawTable::Class* LawTable::ClassOf(Cell r) {
  const auto found = classes_.find(r);
  if (found != classes_.end()) return found->second.get();
  const LongVec low{r.x + 0.0L, r.y + 0.0L, r.z + 0.0L}, high{r.x + 1.0L, r.y + 1.0L, r.z + 1.0L};
  const LongVec centre{r.x + 0.5L, r.y + 0.5L, r.z + 0.5L};
  std::vector<LongPolygon> surface;
  for (const Triangle& t : case_.model) {
    LongPolygon part = ClipToBox(ToLong(t), low, high);
    if (part.size() >= 3 && AreaOfPolygon(part) > 0) surface.push_back(Shifted(part, centre));
  }
  auto& made = classes_[r];
  if (!surface.empty()) {
    made = std::make_unique<Class>(Class{CellLaw(surface, lambda_, per_axis_), {}});
    made->counts.resize(made->law.bins());
  }
  return made.get();
}

std::uint64_t LawTable::Count(const SampleColumns& samples) {
  std::uint64_t counted = 0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const Cell cell = samples.cell[i];
    const auto representative = case_.representative(cell);
    if (!representative) continue;
    ++counted;
    Class* of = ClassOf(*representative);
    if (of == nullptr) {
      ++strangers_;
      continue;
    }
    const Vec3 local = samples.position[i] - Vec3{cell.x + 0.5, cell.y + 0.5, cell.z + 0.5};
    ++of->counts[of->law.BinOf(local)];
    const Moments m = MomentsOf(local.x, local.y, local.z);
    for (std::size_t k = 0; k < kMomentCount; ++k) {
      deviation_[k] += m[k] - of->law.mean()[k];
      variance_[k] += of->law.variance()[k];
    }
  }
  samples_ += counted;
  return counted;
}

ChiSquare LawTable::Test() const {
  ChiSquare sum;
  for (const auto& [cell, of] : classes_) {
    if (of) sum.Add(ChiSquareOf(of->counts, of->law.probability()));
  }
  return sum;
}

Moments LawTable::Scores() const {
  Moments scores{};
  for (std::size_t k = 0; k < kMomentCount; ++k) {
    // On a plane of constant coordinate there is nothing to deviate.
    if (variance_[k] > 1e-12) scores[k] = deviation_[k] / std::sqrt(variance_[k]);
  }
  return scores;
}

LawTable DrawUntil(const LawCase& law_case, double lambda, double table_lambda,
                   std::uint64_t samples, Integrator integrator, std::uint64_t first_seed) {
  LawTable table(law_case, table_lambda);
  SampleOptions options;
  options.lattice = VoxelSize{1};
  options.min_distance = 0;
  options.lambda = lambda;
  options.integrator = integrator;
  options.attributes = kCell;
  options.seed = first_seed;
  while (table.samples() < samples) {
    MemoryMesh mesh(law_case.mesh);
    RunContext context;
    const auto result = SampleMesh(mesh, options, context);
    if (!result) {
      ADD_FAILURE() << result.error().message;
      break;
    }
    if (table.Count(result->samples) == 0) {
      ADD_FAILURE() << "no samples";
      break;
    }
    ++options.seed;
  }
  return table;
}

}  // namespace strata::test
