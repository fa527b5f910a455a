// Draco meshes made by hand.
#pragma once

#include <draco/compression/encode.h>
#include <draco/mesh/triangle_soup_mesh_builder.h>

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

}  // namespace strata::test
