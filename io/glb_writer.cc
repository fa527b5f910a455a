#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/version.h"
#include "io/carried_columns.h"
#include "io/checked_writer.h"
#include "io/format_writers.h"
#include "io/spool.h"
#include "io/srgb.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little, "GLB is little endian");

using Json = nlohmann::ordered_json;

// glTF's numbers for component types.
enum ComponentType : int {
  kByte = 5120,
  kUnsignedByte = 5121,
  kShort = 5122,
  kUnsignedShort = 5123,
  kFloat = 5126
};

std::size_t BytesOf(ComponentType type) {
  return type == kFloat ? 4 : type == kByte || type == kUnsignedByte ? 1 : 2;
}

// A vertex attribute in the making: vertex attributes begin at multiples of four bytes.
struct Accessor {
  std::string name;
  ComponentType type = kFloat;
  int components = 1;
  bool normalized = false;
  std::unique_ptr<Spool> spool;
  std::uint64_t not_finite = 0;  // Floats that were written as something else.

  std::size_t stride() const {
    return (static_cast<std::size_t>(components) * BytesOf(type) + 3) / 4 * 4;
  }
};

const char* ShapeOf(int components) {
  constexpr const char* kShapes[] = {"SCALAR", "VEC2", "VEC3", "VEC4"};
  return kShapes[components - 1];
}

// "_MATERIAL": names of one's own begin with an underscore; letters are capital by custom.
std::string CustomName(const std::string& name) {
  std::string custom = "_";
  for (const char c : name) {
    custom += c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  }
  return custom;
}

double NumberAt(ScalarType type, const char* value) {
  const auto load = [value](auto zero) {
    std::memcpy(&zero, value, sizeof zero);
    return static_cast<double>(zero);
  };
  switch (type) {
    case ScalarType::kUint8:
      return load(std::uint8_t());
    case ScalarType::kUint16:
      return load(std::uint16_t());
    case ScalarType::kFloat64:
      return load(double());
    default:
      return load(float());
  }
}

class GlbWriter final : public FileWriter {
 public:
  GlbWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header,
            const WriterResources& resources)
      : FileWriter(std::move(file), header), resources_(resources) {
    const Bounds& b = header.bounds;
    center_ = b.min + (b.max - b.min) * 0.5;
  }

  Result<void> OpenSpools() {
    Plan();
    for (Accessor& accessor : accessors_) {
      const std::uint64_t most = kMostBytes / accessor.stride();
      if (header().count > most) return TooLarge();
      auto spool =
          Spool::Open(resources_.scratch, resources_.memory, header().count * accessor.stride(),
                      name() + ": the attribute " + accessor.name);
      if (!spool) return Forward(spool);
      accessor.spool = std::move(*spool);
    }
    return TotalBytes() <= kMostBytes ? Result<void>() : Result<void>(TooLarge());
  }

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    next_ = 0;
    auto put = PutFixed(columns);
    for (std::size_t k = 0; put && k < header().carried.size(); ++k) {
      put = PutCarried(header().carried[k], columns.carried[k]);
    }
    return put;
  }

  Result<std::uint64_t> Complete() override {
    std::string json = Document();
    json.resize((json.size() + 3) / 4 * 4, ' ');
    const std::uint64_t binary = TotalBytes(), total = 12 + 8 + json.size() + 8 + binary;
    if (total > kMostBytes) return TooLarge();
    std::string front = "glTF";
    for (const std::uint64_t word : {std::uint64_t{2}, total, std::uint64_t{json.size()}}) {
      PutWord(front, word);
    }
    front += "JSON" + json;
    PutWord(front, binary);
    front += std::string("BIN\0", 4);
    if (auto written = file().Write(front); !written) return Forward(written);
    std::vector<char> portion(std::size_t{1} << 18);
    for (Accessor& accessor : accessors_) {
      if (auto copied = Copy(*accessor.spool, portion); !copied) return Forward(copied);
      accessor.spool.reset();
    }
    return file().Finish();
  }

 private:
  // A GLB's length is a 32-bit number.
  static constexpr std::uint64_t kMostBytes = std::numeric_limits<std::uint32_t>::max() - 65536;

  tl::unexpected<Error> TooLarge() const {
    return Fail(ErrorCode::kOverBudget, name() + ": " + std::to_string(header().count) +
                                            " samples with these attributes need more than the 4 "
                                            "GiB that a glb can have; use ply, npz or drc");
  }
  static void PutWord(std::string& to, std::uint64_t word) {
    const auto w = static_cast<std::uint32_t>(word);
    to.append(reinterpret_cast<const char*>(&w), sizeof w);
  }

  void Add(std::string name, ComponentType type, int components, bool normalized = false) {
    accessors_.push_back({std::move(name), type, components, normalized, nullptr});
  }

  void Plan() {
    Add("POSITION", kFloat, 3);
    if (has(kNormal)) Add("NORMAL", kFloat, 3);
    if (has(kTriangle)) Add("_TRIANGLE", kUnsignedShort, 4);
    if (has(kBarycentric)) Add("_BARYCENTRIC", kFloat, 3);
    for (const char* const axis : {"_CELL_X", "_CELL_Y", "_CELL_Z"}) {
      if (has(kCell)) Add(axis, kUnsignedShort, 2);
    }
    if (has(kArea)) Add("_AREA", kFloat, 1);
    if (has(kWeight)) Add("_WEIGHT", kFloat, 1);
    for (const MeshAttribute& column : header().carried) PlanCarried(column);
  }

  void PlanCarried(const MeshAttribute& column) {
    if (IsColor(column)) {
      Add("COLOR_" + std::to_string(colors_++), kUnsignedShort, column.components, true);
      return;
    }
    if (IsUv(column)) return Add("TEXCOORD_" + std::to_string(uvs_++), kFloat, 2);
    const std::string custom = CustomName(column.name);
    const int words = WordsOf(column.type);
    if (words == 1 && column.components <= 4) {
      return Add(custom, TypeFor(column.type), column.components);
    }
    for (int k = 0; k < column.components; ++k) {
      const std::string one = column.components == 1 ? custom : custom + "_" + std::to_string(k);
      Add(one, words == 1 ? TypeFor(column.type) : kUnsignedShort, words);
    }
  }

  static bool IsColor(const MeshAttribute& column) {
    return strata::IsColor(column.semantic) && column.components >= 3 && column.components <= 4 &&
           column.type != ScalarType::kInt8;
  }
  static bool IsUv(const MeshAttribute& column) {
    return column.semantic == Semantic::kUv && column.components == 2 && !IsInteger(column.type);
  }
  // glTF has no vertex attributes of 32-bit integers: they are cut into words of 16, lowest first.
  static int WordsOf(ScalarType type) {
    return IsInteger(type) && SizeOf(type) >= 4 ? static_cast<int>(SizeOf(type) / 2) : 1;
  }
  static ComponentType TypeFor(ScalarType type) {
    switch (type) {
      case ScalarType::kInt8:
        return kByte;
      case ScalarType::kUint8:
        return kUnsignedByte;
      case ScalarType::kInt16:
        return kShort;
      case ScalarType::kUint16:
        return kUnsignedShort;
      default:
        return kFloat;
    }
  }

  // Fills the next attribute: `value(i, out)` writes sample i.
  template <class Value>
  Result<void> Put(std::size_t n, const Value& value) {
    Accessor& accessor = accessors_[next_++];
    const std::size_t stride = accessor.stride();
    std::vector<char> rows(n * stride);
    for (std::size_t i = 0; i < n; ++i) value(i, rows.data() + i * stride);
    if (accessor.type == kFloat) accessor.not_finite += MakeFinite(rows);
    return accessor.spool->Append({rows.data(), rows.size()});
  }
  // glTF allows finite numbers alone: what is none becomes 0, what is too large the largest there
  // is. Returns how many did.
  static std::uint64_t MakeFinite(std::span<char> floats) {
    constexpr float kMost = std::numeric_limits<float>::max();
    std::uint64_t changed = 0;
    for (std::size_t at = 0; at < floats.size(); at += sizeof(float)) {
      float number;
      std::memcpy(&number, floats.data() + at, sizeof number);
      if (std::isfinite(number)) continue;
      number = std::isnan(number) ? 0 : std::copysign(kMost, number);
      std::memcpy(floats.data() + at, &number, sizeof number);
      ++changed;
    }
    return changed;
  }
  template <std::size_t N>
  static void PutFloats(const std::array<double, N>& numbers, char* out) {
    for (const double number : numbers) {
      const auto single = static_cast<float>(number);
      std::memcpy(out, &single, sizeof single);
      out += sizeof single;
    }
  }

  Result<void> PutFixed(const SampleColumns& s) {
    const std::size_t n = s.size();
    Result<void> ok = Put(n, [&](std::size_t i, char* out) {
      const Vec3 p = s.position[i] - center_;
      PutFloats<3>({p.x, p.y, p.z}, out);
      Enclose(out);
    });
    if (ok && has(kNormal)) {
      ok = Put(n, [&](std::size_t i, char* out) { std::memcpy(out, &s.normal[i], sizeof(Vec3f)); });
    }
    if (ok && has(kTriangle)) {
      ok = Put(n, [&](std::size_t i, char* out) { std::memcpy(out, &s.triangle[i], 8); });
    }
    if (ok && has(kBarycentric)) {
      ok = Put(n, [&](std::size_t i, char* out) { PutFloats<3>(s.barycentric[i], out); });
    }
    for (const auto axis : {&Cell::x, &Cell::y, &Cell::z}) {
      if (!ok || !has(kCell)) break;
      ok = Put(n, [&](std::size_t i, char* out) { std::memcpy(out, &(s.cell[i].*axis), 4); });
    }
    if (ok && has(kArea)) {
      ok = Put(n, [&](std::size_t i, char* out) { PutFloats<1>({s.area[i]}, out); });
    }
    if (ok && has(kWeight)) {
      ok = Put(n, [&](std::size_t i, char* out) { PutFloats<1>({s.weight[i]}, out); });
    }
    return ok;
  }

  // What lies around the positions as they are written: POSITION must say it.
  void Enclose(const char* position) {
    for (std::size_t a = 0; a < 3; ++a) {
      float v;
      std::memcpy(&v, position + a * sizeof v, sizeof v);
      low_[a] = std::min(low_[a], v);
      high_[a] = std::max(high_[a], v);
    }
  }

  Result<void> PutCarried(const MeshAttribute& column, const std::vector<char>& bytes) {
    const std::size_t size = column.bytes(), n = bytes.size() / size, one = SizeOf(column.type);
    const auto at = [&](std::size_t i) { return bytes.data() + i * size; };
    if (IsColor(column)) {
      return Put(n, [&](std::size_t i, char* out) { PutColor(column, at(i), out); });
    }
    const auto copy = [&](const char* value, std::size_t components, char* out) {
      if (column.type != ScalarType::kFloat64) {
        std::memcpy(out, value, components * one);
        return;
      }
      for (std::size_t k = 0; k < components; ++k) {
        PutFloats<1>({NumberAt(column.type, value + k * one)}, out + k * sizeof(float));
      }
    };
    const auto components = static_cast<std::size_t>(column.components);
    if (IsUv(column) || (WordsOf(column.type) == 1 && components <= 4)) {
      return Put(n, [&](std::size_t i, char* out) { copy(at(i), components, out); });
    }
    Result<void> ok;
    for (std::size_t k = 0; ok && k < components; ++k) {
      ok = Put(n, [&](std::size_t i, char* out) { copy(at(i) + k * one, 1, out); });
    }
    return ok;
  }

  // COLOR_n is light, between 0 and 1; alpha is not encoded.
  static void PutColor(const MeshAttribute& column, const char* value, char* out) {
    const double scale = column.type == ScalarType::kUint8    ? 1.0 / 255
                         : column.type == ScalarType::kUint16 ? 1.0 / 65535
                                                              : 1;
    for (int k = 0; k < column.components; ++k, value += SizeOf(column.type), out += 2) {
      double c = NumberAt(column.type, value) * scale;
      c = c > 0 ? std::min(c, 1.0) : 0;
      if (k < 3 && column.color_space == ColorSpace::kSrgb) c = LinearOfSrgb(c);
      const auto word = static_cast<std::uint16_t>(c * 65535 + 0.5);
      std::memcpy(out, &word, sizeof word);
    }
  }

  std::uint64_t TotalBytes() const {
    std::uint64_t bytes = 0;
    for (const Accessor& a : accessors_) bytes += header().count * a.stride();
    return bytes;
  }

  std::string Document() const {
    Json views = Json::array(), accessors = Json::array(), attributes = Json::object();
    std::uint64_t offset = 0;
    for (std::size_t k = 0; k < accessors_.size(); ++k) {
      const Accessor& a = accessors_[k];
      const std::uint64_t bytes = header().count * a.stride();
      views.push_back({{"buffer", 0},
                       {"byteOffset", offset},
                       {"byteLength", bytes},
                       {"byteStride", a.stride()},
                       {"target", 34962}});
      Json accessor = {{"bufferView", k},
                       {"componentType", static_cast<int>(a.type)},
                       {"count", header().count},
                       {"type", ShapeOf(a.components)}};
      if (a.normalized) accessor["normalized"] = true;
      if (a.not_finite > 0) accessor["extras"] = {{"not_finite", a.not_finite}};
      if (k == 0) accessor["min"] = low_, accessor["max"] = high_;
      accessors.push_back(std::move(accessor));
      attributes[a.name] = k;
      offset += bytes;
    }
    const Json document = {
        {"asset", {{"version", "2.0"}, {"generator", "strata " + std::string(kVersion)}}},
        {"extras", Extras()},
        {"scene", 0},
        {"scenes", Json::array({{{"nodes", Json::array({0})}}})},
        {"nodes", Json::array({{{"mesh", 0},
                                {"translation", Json::array({center_.x, center_.y, center_.z})}}})},
        {"meshes",
         Json::array({{{"name", "samples"},
                       {"primitives", Json::array({{{"attributes", attributes}, {"mode", 0}}})}}})},
        {"accessors", accessors},
        {"bufferViews", views},
        {"buffers", Json::array({{{"byteLength", offset}}})}};
    return document.dump(-1, ' ', false, Json::error_handler_t::replace);
  }

  Json Extras() const {
    const auto parsed = [](const std::string& text) {
      Json json = Json::parse(text, nullptr, false);
      return json.is_discarded() ? Json(text) : json;
    };
    Json extras = {{"strata", parsed(header().provenance)}};
    if (header().carried.empty()) return extras;
    extras["columns"] = parsed(ColumnsJson(header().carried));
    for (const MeshAttribute& column : header().carried) {
      if (!column.names.empty()) extras["names"][column.name] = parsed(NamesJson(column));
    }
    return extras;
  }

  Result<void> Copy(Spool& spool, std::vector<char>& portion) {
    for (std::uint64_t done = 0; done < spool.size();) {
      if (resources_.context != nullptr && resources_.context->cancelled()) return Cancelled();
      const std::uint64_t n = std::min<std::uint64_t>(portion.size(), spool.size() - done);
      const std::span<char> part(portion.data(), n);
      if (auto read = spool.Read(done, part); !read) return read;
      if (auto written = file().Write({part.data(), part.size()}); !written) return written;
      spool.DiscardBefore(done += n);
    }
    return {};
  }

  const WriterResources resources_;
  Vec3 center_;
  std::vector<Accessor> accessors_;
  std::size_t next_ = 0;  // To be filled, within Append.
  int colors_ = 0, uvs_ = 0;
  std::array<float, 3> low_ = {HUGE_VALF, HUGE_VALF, HUGE_VALF};
  std::array<float, 3> high_ = {-HUGE_VALF, -HUGE_VALF, -HUGE_VALF};
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeGlbWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources) {
  auto writer = std::make_unique<GlbWriter>(std::move(file), header, resources);
  if (auto opened = writer->OpenSpools(); !opened) return Forward(opened);
  return writer;
}

}  // namespace strata::io
