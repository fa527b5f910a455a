// How a value reaches a sample from the corners of its triangle.
#include "core/mesh_attributes.h"

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "core/carry_attributes.h"
#include "tests/support/memory_mesh.h"
#include "tests/support/mesh_attribute.h"

namespace strata::test {
namespace {

using test::MakeAttribute;

template <class T>
constexpr ScalarType TypeFor();
template <>
constexpr ScalarType TypeFor<float>() {
  return ScalarType::kFloat32;
}
template <>
constexpr ScalarType TypeFor<double>() {
  return ScalarType::kFloat64;
}
template <>
constexpr ScalarType TypeFor<std::uint8_t>() {
  return ScalarType::kUint8;
}
template <>
constexpr ScalarType TypeFor<std::int32_t>() {
  return ScalarType::kInt32;
}
template <>
constexpr ScalarType TypeFor<std::uint64_t>() {
  return ScalarType::kUint64;
}

// The value of a single number at a point.
template <class T>
T CarryOne(const std::array<T, 3>& corner, const std::array<double, 3>& weight, Carry carry) {
  MeshAttribute attribute = MakeAttribute("a", TypeFor<T>(), 1);
  attribute.carry = carry;
  std::array<const char*, 3> at;
  for (std::size_t v = 0; v < 3; ++v) at[v] = reinterpret_cast<const char*>(&corner[v]);
  T out;
  CarryValue(attribute, at, weight, reinterpret_cast<char*>(&out));
  return out;
}

TEST(CarryValue, InterpolatesByTheWeights) {
  const std::array<double, 3> weight = {0.5, 0.25, 0.25};
  EXPECT_EQ(CarryOne<double>({8, 4, 16}, weight, Carry::kLinear), 9);
  EXPECT_EQ(CarryOne<float>({8, 4, 16}, weight, Carry::kLinear), 9);
  EXPECT_EQ(CarryOne<std::uint8_t>({255, 0, 0}, weight, Carry::kLinear), 128);
  EXPECT_EQ(CarryOne<std::uint8_t>({0, 0, 1}, weight, Carry::kLinear), 0);
  EXPECT_EQ(CarryOne<std::int32_t>({-5, -5, -9}, weight, Carry::kLinear), -6);
}

TEST(CarryValue, KeepsWhatIsTheSameAtAllCorners) {
  TestRandom random(7);
  for (int i = 0; i < 1000; ++i) {
    const double value = random.In(-3, 3), b = random.Unit() / 2, c = random.Unit() / 2;
    EXPECT_EQ(CarryOne<double>({value, value, value}, {1 - b - c, b, c}, Carry::kLinear), value);
  }
  const std::uint64_t large = ~std::uint64_t{0} - 1;
  EXPECT_EQ(CarryOne<std::uint64_t>({large, large, large}, {0.3, 0.3, 0.4}, Carry::kLinear), large);
}

TEST(CarryValue, TakesLabelsFromTheNearestCornerAndNeverAveragesThem) {
  const std::array<std::uint64_t, 3> label = {10, 1ULL << 63, 7};
  EXPECT_EQ(CarryOne(label, {0.4, 0.35, 0.25}, Carry::kNearestCorner), 10u);
  EXPECT_EQ(CarryOne(label, {0.3, 0.4, 0.3}, Carry::kNearestCorner), 1ULL << 63);
  EXPECT_EQ(CarryOne(label, {0, 0, 1}, Carry::kNearestCorner), 7u);
  EXPECT_EQ(CarryFor(ScalarType::kInt32, false), Carry::kNearestCorner);
  EXPECT_EQ(CarryFor(ScalarType::kUint8, true), Carry::kLinear);
  EXPECT_EQ(CarryFor(ScalarType::kFloat32, false), Carry::kLinear);
}

TEST(CarryValue, GivesTheSameBitsWhicheverCornerComesFirst) {
  TestRandom random(3);
  for (int i = 0; i < 3000; ++i) {
    // As the race leaves weights: multiples of 2^-50 whose sum is 1.
    const double b = std::floor(random.Unit() * 0x1p49) * 0x1p-50;
    const double c = i % 3 == 0 ? b : std::floor(random.Unit() * 0x1p49) * 0x1p-50;
    const std::array<double, 3> weight = {1 - b - c, b, c};
    std::array<double, 3> value;
    for (double& v : value) v = random.In(-1, 1) * (i % 5 == 0 ? 1e12 : 1);
    for (const Carry carry : {Carry::kLinear, Carry::kNearestCorner}) {
      const double expected = CarryOne(value, weight, carry);
      for (std::size_t turn = 1; turn < 3; ++turn) {
        std::array<double, 3> v, w;
        for (std::size_t k = 0; k < 3; ++k) {
          v[k] = value[(k + turn) % 3];
          w[k] = weight[(k + turn) % 3];
        }
        EXPECT_EQ(CarryOne(v, w, carry), expected) << "case " << i;
      }
    }
  }
}

TEST(CarryValue, LetsACornerOfNoWeightHaveNoSay) {
  const double inf = std::numeric_limits<double>::infinity();
  EXPECT_EQ(CarryOne<double>({inf, 1, 3}, {0, 0.5, 0.5}, Carry::kLinear), 2);
  EXPECT_TRUE(std::isnan(CarryOne<double>({NAN, 1, 3}, {0.1, 0.5, 0.4}, Carry::kLinear)));
}

TEST(FixNames, KeepsClearOfTheFixedNames) {
  std::vector<MeshAttribute> attributes(6);
  const char* const names[] = {"area", "label", "label", "nx", "", "a b/c"};
  for (std::size_t k = 0; k < 6; ++k) attributes[k].name = names[k];
  FixNames(attributes);
  const char* const expected[] = {"mesh_area", "label", "label_2", "mesh_nx", "attribute", "a_b_c"};
  for (std::size_t k = 0; k < 6; ++k) EXPECT_EQ(attributes[k].name, expected[k]);
}

std::vector<MeshAttribute> Some() {
  return {MakeAttribute("color", ScalarType::kUint8, 3, Semantic::kColor),
          MakeAttribute("label", ScalarType::kInt32, 1),
          MakeAttribute("paint", ScalarType::kUint8, 3, Semantic::kColor),
          MakeAttribute("vertex_normal", ScalarType::kFloat32, 3, Semantic::kNormal)};
}

std::vector<std::size_t> Wanted(const std::vector<std::string>& names) {
  SampleOptions options;
  options.mesh_attributes = names;
  const auto plan = PlanCarry(Some(), options);
  EXPECT_TRUE(plan) << plan.error().message;
  return plan ? plan->wanted : std::vector<std::size_t>();
}

TEST(PlanCarry, TakesNamesAndWhatTheyMean) {
  using Numbers = std::vector<std::size_t>;
  EXPECT_EQ(Wanted({}), Numbers{});
  EXPECT_EQ(Wanted({"label"}), Numbers{1});
  EXPECT_EQ(Wanted({"color"}), (Numbers{0, 2}));
  EXPECT_EQ(Wanted({"paint", "label"}), (Numbers{1, 2}));
  EXPECT_EQ(Wanted({"all"}), (Numbers{0, 1, 2, 3}));
}

TEST(PlanCarry, ListsWhatIsThereWhenSomethingIsNot) {
  SampleOptions options;
  options.mesh_attributes = {"colour"};
  const auto plan = PlanCarry(Some(), options);
  ASSERT_FALSE(plan);
  EXPECT_EQ(plan.error().code, ErrorCode::kInvalidArgument);
  EXPECT_EQ(
      plan.error().message,
      "the attribute 'colour' is not there; the mesh carries: color (3 x uint8, vertex), "
      "label (int32, vertex), paint (3 x uint8, vertex), vertex_normal (3 x float32, vertex)");
  options.mesh_attributes = {};
  options.vertex_normals = true;
  const auto without = PlanCarry({}, options);
  ASSERT_FALSE(without);
  EXPECT_EQ(without.error().message, "there are no vertex normals; the mesh carries: none");
}

}  // namespace
}  // namespace strata::test
