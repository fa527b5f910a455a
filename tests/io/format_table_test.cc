// Every glTF and Draco file of the collection: read as its index says, or refused for a reason.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <sstream>
#include <string>

#include "core/vec3.h"
#include "io/open_mesh.h"
#include "tests/support/read_mesh.h"
#include "tests/support/test_data.h"

namespace strata::io {
namespace {

// By the end of the path: what the message says.
const std::map<std::string, std::string>& Refused() {
  static const std::map<std::string, std::string> kRefused = {
      {"cube_pc.drc", "point cloud"},
      {"pc_color.drc", "point cloud"},
      {"pc_kd_color.drc", "Draco version 2.3"},
      {"point_cloud_no_qp.drc", "Draco version 2.3"},
      {"RecursiveNodes.gltf", "is its own descendant"},
      {"sceneWrongType.gltf", "/scene: found '\"hello\"'"},
      {"NoScene.gltf", "/scene: found index 0 of 0"},
      {"badArray.gltf", "/meshes/0/primitives"},
      {"integer-out-of-bounds.gltf", "/bufferViews/0/byteLength: found '1e+300'"},
      {"invalid-buffer-index.gltf", "/bufferViews/1/buffer: found index 1 of 1"},
      {"invalid-primitive-indices.gltf", "/bufferViews/0/buffer"},
      {"issue-416.gltf", "/asset/version"},
      {"accessor/empty_object.gltf", "/accessors/0/count: found nothing"},
      {"unresolved_bufferviews.gltf", "/accessors/0/bufferView"},
      {"buffer/invalid_object.gltf", "/buffers/0: found"},
      {"buffer_view/empty_object.gltf", "/bufferViews/0/buffer: found nothing"},
      {"chunk_too_big.glb", "byte 13: found the end of the file in a chunk's header"},
      {"empty_file.glb", "the file is empty"},
      {"empty_json_chunk.glb", "byte 20: not JSON"},
      {"empty_json_object.glb", "/asset/version: found nothing"},
      {"invalid_json_chunk.glb", "byte 22: not JSON"},
      {"invalid_magic.glb", "not JSON"},
      {"invalid_version.glb", "GLB version 0"},
      {"misplaced_bin_chunk.glb", "not the second"},
      {"no_header.glb", "not JSON"},
      {"only_bin_chunk.glb", "expected the first chunk to be JSON"},
      {"truncated_chunk_header.glb", "chunk's header"},
      {"two_empty_bin_chunks.glb", "expected the first chunk to be JSON"},
      {"two_valid_json_chunks.glb", "second JSON chunk"},
      {"zero_chunk_header.glb", "expected the first chunk to be JSON"},
      {"json/empty_file.gltf", "the file is empty"},
      {"json/invalid_object.gltf", "the root: found '[]'"},
      {"invalid_syntax.gltf", "byte 2: not JSON"},
      {"mesh/bufferview_target_override.gltf", "/buffers/0: has no uri"},
      {"indices_bytestride.gltf", "/buffers/0: has no uri"},
      {"indices_invalid_format.gltf", "/indices: expected SCALAR"},
      {"morph_bufferview_target_override.gltf", "/buffers/0: has no uri"},
      {"unresolved_positions.gltf", "/attributes/POSITION: found index 0 of 0"},
      {"infinite_transform.gltf", "number overflow"},
      {"matrix_indecomposable.gltf", "expected the last row"},
      {"node_loop.gltf", "is its own descendant"},
      {"node_loop_scene.gltf", "is its own descendant"},
      {"unresolved_child_node.gltf", "/nodes/0/children/0"},
      {"unresolved_mesh.gltf", "/nodes/0/mesh"},
      {"unresolved_default_scene.gltf", "/scene: found index 0 of 0"},
      {"unresolved_node.gltf", "/scenes/0/nodes/0"},
  };
  return kRefused;
}

// Where the index, which knows no skins, no rests of corners and no mesh without a node, and which
// takes the bounds that accessors claim, says otherwise.
bool IndexKnowsLess(const test::IndexedFile& file) {
  const auto& path = file.path;
  return file.notes.find("meshrefs=0/") != std::string::npos ||
         path.ends_with("IncorrectVertexArrays/Cube.gltf") ||
         path.ends_with("ZeroLengthBufferView.gltf") || path.ends_with("simple_skin.gltf") ||
         path.ends_with("2CylinderEngine.gltf");
}

Bounds BoundsOf(const test::WholeMesh& mesh) {
  Bounds bounds;
  for (const auto& triangle : mesh.triangles) {
    for (const Vec3 corner : triangle) bounds.Add(corner);
  }
  return bounds;
}

void ExpectBounds(std::string text, const Bounds& bounds) {
  for (char& c : text) c = c == ',' || c == ':' ? ' ' : c;
  std::istringstream in(text);
  std::array<double, 6> expected{};
  for (double& value : expected) in >> value;
  double size = 0;
  for (const double value : expected) size = std::max(size, std::fabs(value));
  for (int axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<std::size_t>(axis);
    EXPECT_NEAR(bounds.min[axis], expected[i], 1e-5 * size);
    EXPECT_NEAR(bounds.max[axis], expected[3 + i], 1e-5 * size);
  }
}

TEST(FormatTable, EveryFileIsReadAsItsIndexSaysOrRefusedForAReason) {
  const std::filesystem::path folder = test::TestDataFolder(STRATA_SOURCE_DIR);
  if (!std::filesystem::exists(folder / "INDEX.tsv")) {
    GTEST_SKIP() << "no collection of meshes in " << folder << " (STRATA_TEST_DATA)";
  }
  int read = 0, refused = 0;
  for (const test::IndexedFile& file : test::ReadIndex(folder)) {
    const bool ours = file.format.starts_with("gl") || file.format.starts_with("GLB") ||
                      file.format.starts_with("Draco");
    if (!ours) continue;
    SCOPED_TRACE(file.path + ' ' + file.notes);
    const auto mesh = test::ReadWhole(OpenMesh((folder / file.path).string()), 4096);
    const auto reason = std::find_if(Refused().begin(), Refused().end(), [&](const auto& entry) {
      return file.path.ends_with('/' + entry.first);
    });
    if (reason != Refused().end()) {
      ++refused;
      ASSERT_FALSE(mesh);
      EXPECT_NE(mesh.error().message.find(reason->second), std::string::npos)
          << mesh.error().message;
      continue;
    }
    ASSERT_TRUE(mesh) << mesh.error().message;
    ++read;
    if (IndexKnowsLess(file)) continue;
    EXPECT_EQ(std::to_string(mesh->counts.triangles), file.triangles);
    if (file.triangles == "0") continue;
    EXPECT_EQ(std::to_string(mesh->counts.vertices), file.vertices);
    const Bounds bounds = BoundsOf(*mesh);
    // Accessors without bytes are zeros, whatever bounds they claim.
    if (bounds.min != bounds.max) ExpectBounds(file.bounds, bounds);
  }
  EXPECT_GE(read, 90);
  EXPECT_EQ(refused, static_cast<int>(Refused().size()));
}

}  // namespace
}  // namespace strata::io
