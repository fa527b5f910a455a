#include "core/mesh_attributes.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <set>
#include <type_traits>
#include <utility>

#include "core/numeric.h"
#include "core/samples.h"

namespace strata {
namespace {

// What the columns of samples and the properties of a PLY are called.
constexpr std::array kTaken = {"position", "x",  "y",  "z",      "nx",     "ny",     "nz",
                               "b0",       "b1", "b2", "cell_x", "cell_y", "cell_z", "provenance"};

bool IsTaken(std::string_view name) {
  const auto same = [name](const char* other) { return name == other; };
  return std::any_of(kTaken.begin(), kTaken.end(), same) ||
         std::any_of(kAttributeNames.begin(), kAttributeNames.end(), same);
}

bool IsPlain(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
         c == '.' || c == '-';
}

template <class T>
T Load(const char* from, int component) {
  T value;
  std::memcpy(&value, from + static_cast<std::size_t>(component) * sizeof(T), sizeof(T));
  return value;
}

// Whether a < b, with every NaN last and -0 equal to 0.
template <class T>
bool Less(T a, T b) {
  if constexpr (std::is_floating_point_v<T>) {
    if (std::isnan(a) || std::isnan(b)) return !std::isnan(a);
  }
  return a < b;
}

template <class T>
bool IsSmaller(const char* a, const char* b, int components) {
  for (int k = 0; k < components; ++k) {
    const T x = Load<T>(a, k), y = Load<T>(b, k);
    if (Less(x, y)) return !Less(y, x);
    if (Less(y, x)) return false;
  }
  return false;
}

template <class T>
std::size_t NearestCorner(const std::array<const char*, 3>& corner,
                          const std::array<double, 3>& weight, int components) {
  std::size_t best = 0;
  for (std::size_t v = 1; v < 3; ++v) {
    const bool nearer = weight[v] > weight[best];
    const bool tied = weight[v] == weight[best];
    if (nearer || (tied && IsSmaller<T>(corner[v], corner[best], components))) best = v;
  }
  return best;
}

// The sum of three, in an order that is a function of the three alone.
double SumInOrder(double a, double b, double c) {
  if (b < a) std::swap(a, b);
  if (c < b) std::swap(b, c);
  if (b < a) std::swap(a, b);
  return (a + b) + c;
}

template <class T>
T Rounded(double value) {
  if constexpr (std::is_floating_point_v<T>) {
    return static_cast<T>(value);
  } else {
    const double low = static_cast<double>(std::numeric_limits<T>::lowest());
    const double high = static_cast<double>(std::numeric_limits<T>::max());
    // Corners' values lie in the range, and so does what lies between them, but for rounding.
    if (value >= high) return std::numeric_limits<T>::max();
    if (!(value > low)) return std::numeric_limits<T>::lowest();
    return static_cast<T>(std::fabs(value) < 0x1p51 ? RoundToInteger(value) : value);
  }
}

template <class T>
T Interpolate(const std::array<const char*, 3>& corner, const std::array<double, 3>& weight,
              int component) {
  double part[3];
  T value[3];
  for (std::size_t v = 0; v < 3; ++v) {
    value[v] = Load<T>(corner[v], component);
    // What lies opposite has no say, be it infinite.
    part[v] = weight[v] == 0 ? 0 : weight[v] * static_cast<double>(value[v]);
  }
  // What is the same everywhere stays it, to the bit.
  if (value[0] == value[1] && value[1] == value[2]) return value[0];
  return Rounded<T>(SumInOrder(part[0], part[1], part[2]));
}

}  // namespace

const char* NameOf(ScalarType type) {
  constexpr const char* kNames[] = {"int8",   "uint8", "int16",  "uint16",  "int32",
                                    "uint32", "int64", "uint64", "float32", "float64"};
  return kNames[static_cast<std::size_t>(type)];
}

const char* NameOf(AttributeDomain domain) {
  constexpr const char* kNames[] = {"vertex", "corner", "triangle", "instance"};
  return kNames[static_cast<std::size_t>(domain)];
}

const char* NameOf(Semantic semantic) {
  constexpr const char* kNames[] = {"generic", "normal", "color", "uv",   "material",
                                    "mesh",    "object", "group", "node", "texture"};
  return kNames[static_cast<std::size_t>(semantic)];
}

const char* NameOf(ColorSpace space) {
  constexpr const char* kNames[] = {"none", "srgb", "linear"};
  return kNames[static_cast<std::size_t>(space)];
}

void FixNames(std::vector<MeshAttribute>& attributes) {
  std::set<std::string> seen;
  for (MeshAttribute& attribute : attributes) {
    std::string& name = attribute.name;
    if (name.empty()) name = "attribute";
    std::replace_if(
        name.begin(), name.end(), [](char c) { return !IsPlain(c); }, '_');
    if (IsTaken(name)) name = "mesh_" + name;
    const std::string stem = name;
    for (int k = 2; !seen.insert(name).second; ++k) name = stem + "_" + std::to_string(k);
  }
}

std::string Describe(const MeshAttribute& attribute) {
  std::string text = attribute.name + " (";
  if (attribute.components > 1) text += std::to_string(attribute.components) + " x ";
  return text + NameOf(attribute.type) + ", " + NameOf(attribute.domain) + ")";
}

std::string Describe(std::span<const MeshAttribute> attributes) {
  std::string text;
  for (const MeshAttribute& a : attributes) text += (text.empty() ? "" : ", ") + Describe(a);
  return text.empty() ? "none" : text;
}

void CarryValue(const MeshAttribute& attribute, const std::array<const char*, 3>& corner,
                const std::array<double, 3>& weight, char* out) {
  if (attribute.carry == Carry::kConstant) {
    std::memcpy(out, corner[0], attribute.bytes());
    return;
  }
  WithType(attribute.type, [&](auto zero) {
    using T = decltype(zero);
    if (attribute.carry == Carry::kNearestCorner) {
      const std::size_t nearest = NearestCorner<T>(corner, weight, attribute.components);
      std::memcpy(out, corner[nearest], attribute.bytes());
      return;
    }
    for (int k = 0; k < attribute.components; ++k) {
      const T value = Interpolate<T>(corner, weight, k);
      std::memcpy(out + static_cast<std::size_t>(k) * sizeof(T), &value, sizeof(T));
    }
  });
}

}  // namespace strata
