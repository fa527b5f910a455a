// Draco meshes made by hand.
#pragma once

#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>

#include <cstdint>
#include <memory>
#include <string>
#include <utility>

namespace strata::test {

/// A strip of `n` squares as Draco data; lossless, since no quantisation is asked for.
inline std::string MakeDraco(int n, bool edgebreaker, bool metadata = false) {
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(2 * n);
  const int id = builder.AddAttribute(draco::GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  for (int i = 0; i < n; ++i) {
    const auto x = static_cast<float>(i);
    const float a[3] = {x, 0, 0.1f}, b[3] = {x + 1, 0, 0.1f}, c[3] = {x + 1, 1, 0.1f},
                d[3] = {x, 1, 0.1f};
    builder.SetAttributeValuesForFace(id, draco::FaceIndex(static_cast<unsigned>(2 * i)), a, b, c);
    builder.SetAttributeValuesForFace(id, draco::FaceIndex(static_cast<unsigned>(2 * i + 1)), a, c,
                                      d);
  }
  auto mesh = builder.Finalize();
  if (metadata) {
    auto data = std::make_unique<draco::GeometryMetadata>();
    data->AddEntryString("name", "strip");
    data->AddSubMetadata("more", std::make_unique<draco::Metadata>());
    mesh->AddMetadata(std::move(data));
  }
  draco::Encoder encoder;
  encoder.SetEncodingMethod(edgebreaker ? draco::MESH_EDGEBREAKER_ENCODING
                                        : draco::MESH_SEQUENTIAL_ENCODING);
  draco::EncoderBuffer buffer;
  if (!encoder.EncodeMeshToBuffer(*mesh, &buffer).ok()) return "";
  return {buffer.data(), buffer.size()};
}

/// Two triangles of the unit square with normals, colours, two sets of texture coordinates, a label
/// of 32 and one of 64 bits, and a face's material with its names; at z = 0. Lossless.
inline std::string MakeFullDraco(bool edgebreaker) {
  using draco::GeometryAttribute;
  draco::TriangleSoupMeshBuilder builder;
  builder.Start(2);
  const int position = builder.AddAttribute(GeometryAttribute::POSITION, 3, draco::DT_FLOAT32);
  const int normal = builder.AddAttribute(GeometryAttribute::NORMAL, 3, draco::DT_FLOAT32);
  const int color = builder.AddAttribute(GeometryAttribute::COLOR, 4, draco::DT_UINT8);
  const int uv = builder.AddAttribute(GeometryAttribute::TEX_COORD, 2, draco::DT_FLOAT32);
  const int uv1 = builder.AddAttribute(GeometryAttribute::TEX_COORD, 2, draco::DT_FLOAT32);
  const int label = builder.AddAttribute(GeometryAttribute::GENERIC, 1, draco::DT_INT32);
  const int key = builder.AddAttribute(GeometryAttribute::GENERIC, 1, draco::DT_INT64);
  const int material = builder.AddAttribute(GeometryAttribute::GENERIC, 1, draco::DT_UINT8);
  struct Corner {
    float position[3], normal[3];
    std::uint8_t color[4];
    float uv[2], uv1[2];
    std::int32_t label;
    std::int64_t key;
  };
  const Corner a{{0, 0, 0}, {0, 0, 1}, {0, 0, 7, 255}, {0, 0}, {1, 5}, -7, -1};
  const Corner b{{1, 0, 0}, {1, 0, 0}, {255, 0, 7, 255}, {1, 0}, {0, 5}, 300007, 1};
  const Corner c{{1, 1, 0}, {0, 1, 0}, {255, 255, 7, 255}, {1, 1}, {0, 6}, 12, 9007199254740993};
  const Corner d{{0, 1, 0}, {0, 0, 1}, {0, 255, 7, 255}, {0, 1}, {1, 6}, 13, 2};
  const auto face = [&](unsigned number, const Corner& x, const Corner& y, const Corner& z) {
    const draco::FaceIndex f(number);
    builder.SetAttributeValuesForFace(position, f, x.position, y.position, z.position);
    builder.SetAttributeValuesForFace(normal, f, x.normal, y.normal, z.normal);
    builder.SetAttributeValuesForFace(color, f, x.color, y.color, z.color);
    builder.SetAttributeValuesForFace(uv, f, x.uv, y.uv, z.uv);
    builder.SetAttributeValuesForFace(uv1, f, x.uv1, y.uv1, z.uv1);
    builder.SetAttributeValuesForFace(label, f, &x.label, &y.label, &z.label);
    builder.SetAttributeValuesForFace(key, f, &x.key, &y.key, &z.key);
    const auto of_face = static_cast<std::uint8_t>(number);
    builder.SetPerFaceAttributeValueForFace(material, f, &of_face);
  };
  face(0, a, b, c);
  face(1, a, c, d);
  auto mesh = builder.Finalize();
  const auto name = [&](int id, const char* text) {
    auto data = std::make_unique<draco::AttributeMetadata>();
    data->AddEntryString("name", text);
    return data;
  };
  mesh->AddAttributeMetadata(label, name(label, "label"));
  auto names = name(material, "material");
  names->AddEntryInt("oak", 0);
  names->AddEntryInt("ash", 1);
  names->AddEntryString("file_name", "a.mtl");
  mesh->AddAttributeMetadata(material, std::move(names));
  draco::Encoder encoder;
  encoder.SetEncodingMethod(edgebreaker ? draco::MESH_EDGEBREAKER_ENCODING
                                        : draco::MESH_SEQUENTIAL_ENCODING);
  draco::EncoderBuffer buffer;
  if (!encoder.EncodeMeshToBuffer(*mesh, &buffer).ok()) return "";
  return {buffer.data(), buffer.size()};
}

}  // namespace strata::test
