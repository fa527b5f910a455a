// Surfaces on which the law of the samples is known cell by cell.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/sample_mesh.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/surface_law.h"

namespace strata::test {

/// A mesh over a lattice of edge 1 at the origin whose cells fall into few classes: the surface in
/// a cell is a translate of the surface in its class's representative.
struct LawCase {
  std::string name;
  Triangles mesh;
  /// The representative of a cell; nothing where the mesh's border would show.
  std::function<std::optional<Cell>(Cell)> representative;
  /// The surface about the representatives (its triangles need not be the mesh's).
  Triangles model;
};

/// The plane z = 1/2, through the centres of n × n cells, as two triangles.
LawCase PlaneThroughCentres(int n);
/// The plane z = 5x/8 + 3y/8 + 5/16 over n × n columns of cells.
LawCase ObliquePlane(int n);
/// The plane through the centres as a fan of thousands of triangles as long as the mesh.
LawCase FanOfSlivers(int n);
/// The same as strips a fraction of a cell wide and n cells long.
LawCase StripSlivers(int n);
/// The same as needles within the cells, down to 2^-18 of an edge wide.
LawCase NeedlesInCells(int n);
/// The oblique plane as strips.
LawCase ObliqueSlivers(int n);
/// Corners where three planes meet, one right-angled and one not, n^3 copies of each.
LawCase Corners(int n);
/// Triangles of all sizes across one cell and its neighbours, n^3 copies.
LawCase Soup(int n);
std::vector<LawCase> AllLawCases();

/// Samples in bins per class.
class LawTable {
 public:
  LawTable(const LawCase& law_case, double lambda, int per_axis = 6);
  /// Counts the samples of one run. Returns how many fell into cells with a class.
  std::uint64_t Count(const SampleColumns& samples);
  ChiSquare Test() const;
  /// Per moment: the deviation of the samples' sum from its expectation, in standard deviations.
  Moments Scores() const;
  std::uint64_t samples() const { return samples_; }
  /// Samples in cells on whose class the model has no surface.
  std::uint64_t strangers() const { return strangers_; }

 private:
  struct Class {
    CellLaw law;
    std::vector<std::uint64_t> counts;
  };
  Class* ClassOf(Cell representative);

  const LawCase& case_;
  double lambda_;
  int per_axis_;
  std::map<Cell, std::unique_ptr<Class>> classes_;
  std::uint64_t samples_ = 0, strangers_ = 0;
  Moments deviation_{}, variance_{};
};

/// Draws from `law_case` with seeds `first_seed`, … until the table of `table_lambda` holds at
/// least `samples`.
LawTable DrawUntil(const LawCase& law_case, double lambda, double table_lambda,
                   std::uint64_t samples, Integrator integrator = Integrator::kExact,
                   std::uint64_t first_seed = 1);

}  // namespace strata::test
