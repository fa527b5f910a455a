// glTF files made by hand.
#pragma once

#include <cstdint>
#include <cstring>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace strata::test {

inline std::string Base64(const std::string& bytes) {
  constexpr const char* kDigits =
      "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      word = word << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      text += i + k > bytes.size() ? '=' : kDigits[word >> (18 - 6 * k) & 63];
    }
  }
  return text;
}

/// Collects buffer, views and accessors; the rest of the document is written through `json`.
/// A new document has one mesh to be filled in and one node that places it.
class GltfMaker {
 public:
  using Json = nlohmann::json;

  GltfMaker() {
    json = {{"asset", {{"version", "2.0"}}},
            {"scene", 0},
            {"scenes", {{{"nodes", {0}}}}},
            {"nodes", {{{"mesh", 0}}}},
            {"meshes", {{{"primitives", Json::array()}}}}};
  }

  /// Adds the bytes of `values` as a view; returns its number. `stride`: 0 = none is written.
  template <class T>
  int View(const std::vector<T>& values, int stride = 0) {
    while (bin.size() % 4 != 0) bin += '\0';
    Json view = {
        {"buffer", 0}, {"byteOffset", bin.size()}, {"byteLength", values.size() * sizeof(T)}};
    if (stride != 0) view["byteStride"] = stride;
    bin.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
    json["bufferViews"].push_back(view);
    return static_cast<int>(json["bufferViews"].size()) - 1;
  }
  int Accessor(Json accessor) {
    json["accessors"].push_back(std::move(accessor));
    return static_cast<int>(json["accessors"].size()) - 1;
  }
  /// An accessor over a view of its own.
  template <class T>
  int Values(const std::vector<T>& values, const char* type, int components, int component_type,
             bool normalized = false) {
    Json accessor = {{"bufferView", View(values)},
                     {"componentType", component_type},
                     {"count", values.size() / static_cast<std::size_t>(components)},
                     {"type", type}};
    if (normalized) accessor["normalized"] = true;
    return Accessor(accessor);
  }
  int Floats3(const std::vector<float>& values) { return Values(values, "VEC3", 3, 5126); }
  int Indices(const std::vector<std::uint16_t>& values) {
    return Values(values, "SCALAR", 1, 5123);
  }

  Json& Primitive(int positions, int indices = -1, int mode = -1, int mesh = 0) {
    Json primitive = {{"attributes", {{"POSITION", positions}}}};
    if (indices >= 0) primitive["indices"] = indices;
    if (mode >= 0) primitive["mode"] = mode;
    Json& list = json["meshes"][static_cast<std::size_t>(mesh)]["primitives"];
    list.push_back(primitive);
    return list.back();
  }

  /// With the buffer as a data URI.
  std::string Text() const {
    Json whole = json;
    whole["buffers"] = {{{"byteLength", bin.size()},
                         {"uri", "data:application/octet-stream;base64," + Base64(bin)}}};
    return whole.dump();
  }
  /// With the buffer in a file of this name.
  std::string TextBeside(const std::string& uri) const {
    Json whole = json;
    whole["buffers"] = {{{"byteLength", bin.size()}, {"uri", uri}}};
    return whole.dump();
  }
  std::string Glb() const {
    Json whole = json;
    whole["buffers"] = {{{"byteLength", bin.size()}}};
    std::string text = whole.dump(), chunk = bin;
    while (text.size() % 4 != 0) text += ' ';
    while (chunk.size() % 4 != 0) chunk += '\0';
    const auto word = [](std::size_t value) {
      const auto small = static_cast<std::uint32_t>(value);
      return std::string(reinterpret_cast<const char*>(&small), 4);
    };
    return "glTF" + word(2) + word(28 + text.size() + chunk.size()) + word(text.size()) + "JSON" +
           text + word(chunk.size()) + std::string("BIN\0", 4) + chunk;
  }

  Json json;
  std::string bin;
};

}  // namespace strata::test
