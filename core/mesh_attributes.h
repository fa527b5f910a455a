// What a mesh carries besides its shape, and how it reaches a sample.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata {

/// What a component of a value is, in the machine's byte order.
enum class ScalarType : std::uint8_t {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64
};
inline constexpr int kScalarTypeCount = 10;

/// Bytes of one.
constexpr std::size_t SizeOf(ScalarType type) {
  constexpr std::size_t kSizes[] = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return kSizes[static_cast<std::size_t>(type)];
}
constexpr bool IsInteger(ScalarType type) { return type < ScalarType::kFloat32; }
/// Calls `f` with a zero of the C++ type that `type` names, and returns what it returns.
template <class F>
decltype(auto) WithType(ScalarType type, F&& f) {
  switch (type) {
    case ScalarType::kInt8:
      return f(std::int8_t{});
    case ScalarType::kUint8:
      return f(std::uint8_t{});
    case ScalarType::kInt16:
      return f(std::int16_t{});
    case ScalarType::kUint16:
      return f(std::uint16_t{});
    case ScalarType::kInt32:
      return f(std::int32_t{});
    case ScalarType::kUint32:
      return f(std::uint32_t{});
    case ScalarType::kInt64:
      return f(std::int64_t{});
    case ScalarType::kUint64:
      return f(std::uint64_t{});
    case ScalarType::kFloat32:
      return f(float{});
    default:
      return f(double{});
  }
}
/// "int8", "uint8", … "float64".
const char* NameOf(ScalarType type);

/// To what a file ties a value. For reports; how a value is carried is Carry's alone.
enum class AttributeDomain : std::uint8_t { kVertex, kCorner, kTriangle, kInstance };
/// "vertex", "corner", "triangle", "instance".
const char* NameOf(AttributeDomain domain);

/// How the values at a triangle's corners become that of a sample inside.
enum class Carry : std::uint8_t {
  kLinear,         ///< By the barycentric weights; integers are rounded to the nearest.
  kNearestCorner,  ///< Of the corner with the largest weight: for what must not be averaged.
  kConstant,       ///< One value for the triangle.
  kLookedUp,       ///< The reader finds it by position (textures): there are no corner values.
};

/// What a value means, so that writers can say it in their format's words.
enum class Semantic : std::uint8_t {
  kGeneric,
  kNormal,    ///< Three components; of any length as carried.
  kColor,     ///< Three or four components; integers stand for [0, 1], whatever `normalized`.
  kUv,        ///< Two components.
  kMaterial,  ///< This and what follows: one integer, which `names` names.
  kMesh,
  kObject,
  kGroup,
  kNode,
  kTexture,  ///< As kColor: the colour of the material, its texture looked up.
};
/// "generic", "normal", "color", "uv", "material", "mesh", "object", "group", "node", "texture".
const char* NameOf(Semantic semantic);
/// Of three or four components that are red, green, blue and alpha.
constexpr bool IsColor(Semantic semantic) {
  return semantic == Semantic::kColor || semantic == Semantic::kTexture;
}

/// What a colour's numbers are proportional to. Values are carried as they are, never converted.
enum class ColorSpace : std::uint8_t {
  kNone,    ///< No colour.
  kSrgb,    ///< Encoded for display: what PLY, OBJ and OFF mean by custom, and textures of glTF.
  kLinear,  ///< Light: vertex colours of glTF.
};
/// "none", "srgb", "linear".
const char* NameOf(ColorSpace space);

/// One attribute of a mesh, and the column of samples that it becomes.
struct MeshAttribute {
  std::string name;  ///< Unique in the mesh, and none of the fixed names (FixNames).
  ScalarType type = ScalarType::kFloat32;  ///< Of the values in the column.
  int components = 1;                      ///< 1 to kMostComponents.
  AttributeDomain domain = AttributeDomain::kVertex;
  Carry carry = Carry::kLinear;
  bool normalized = false;  ///< Integers stand for numbers in [0, 1], or [-1, 1].
  Semantic semantic = Semantic::kGeneric;
  int set = 0;  ///< Which of several colours or UVs.
  ColorSpace color_space = ColorSpace::kNone;
  /// Value k is called names[k]; empty = the numbers are not numbers of a table. Values beyond it
  /// have no name.
  std::vector<std::string> names;

  std::size_t bytes() const { return SizeOf(type) * static_cast<std::size_t>(components); }
  friend bool operator==(const MeshAttribute&, const MeshAttribute&) = default;
};
inline constexpr int kMostComponents = 16;

/// What Carry::kLinear or kNearestCorner suits, from the type alone: integers that stand for
/// nothing else are labels.
constexpr Carry CarryFor(ScalarType type, bool normalized) {
  return IsInteger(type) && !normalized ? Carry::kNearestCorner : Carry::kLinear;
}

/// Makes names unique and different from the fixed ones (core/samples.h and the writers' names for
/// coordinates): "mesh_" goes before those, and _2, _3, … behind what was there before. An empty
/// name becomes "attribute". What is neither letter, digit nor one of _.- becomes _.
void FixNames(std::vector<MeshAttribute>& attributes);

/// "name (3 x uint8, vertex)": for messages.
std::string Describe(const MeshAttribute& attribute);
/// All of them with commas between, or "none".
std::string Describe(std::span<const MeshAttribute> attributes);

/// A point on the surface, as samples know it.
struct SurfacePoint {
  std::uint64_t triangle = 0;  ///< Its number in file order, as TriangleBatch::ids.
  /// Weights of the triangle's corners in file order, >= 0; the sum is 1 exactly.
  std::array<double, 3> weight{};
};

/// The value at a point from those at its triangle's corners, in file order, which lie anywhere;
/// for kConstant corner[0] alone is looked at. `out` takes attribute.bytes(). Not for kLookedUp.
///
/// The bytes do not depend on which corner comes first: products are added in the order of their
/// size, and of equally near corners the one with the smallest value (component by component,
/// numbers before NaN) is taken. Float and double are computed in double and rounded once.
void CarryValue(const MeshAttribute& attribute, const std::array<const char*, 3>& corner,
                const std::array<double, 3>& weight, char* out);

/// Gives the attributes of points on a mesh. From MeshReader::ReadAttributes.
///
/// Threads: one at a time. Memory: what the reader's page says, whatever the size of the mesh, plus
/// some hundred bytes a point of one call.
class AttributePass {
 public:
  virtual ~AttributePass() = default;

  /// The next points, ascending by triangle (equal ones too) over all calls together. out[k], for
  /// the k-th attribute that was asked for, takes points.size() values one after the other. Every
  /// triangle must be one that Read gave. Errors: those of MeshReader::Read; kCorruptInput for what
  /// is wrong with attributes (and was not looked at before); kCancelled.
  virtual Result<void> Read(std::span<const SurfacePoint> points, std::span<char* const> out) = 0;
};

}  // namespace strata
