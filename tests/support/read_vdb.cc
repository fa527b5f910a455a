#include "tests/support/read_vdb.h"

#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointDataGrid.h>

#include <stdexcept>

namespace strata::test {
namespace {

namespace points = openvdb::points;
using Leaf = points::PointDataTree::LeafNodeType;

Vec3 ToVec3(const openvdb::Vec3d& v) { return {v.x(), v.y(), v.z()}; }

template <class T>
void AppendValues(const points::AttributeArray& array, VdbPoints::Attribute& out) {
  const points::AttributeHandle<T> handle(array);
  out.point_bytes = sizeof(T) * handle.stride();
  for (openvdb::Index i = 0; i < handle.size(); ++i) {
    for (openvdb::Index k = 0; k < handle.stride(); ++k) {
      const T value = handle.get(i, k);
      out.bytes.insert(out.bytes.end(), reinterpret_cast<const char*>(&value),
                       reinterpret_cast<const char*>(&value + 1));
    }
  }
}

void Append(const points::AttributeArray& array, VdbPoints::Attribute& out) {
  out.type = array.valueType();
  out.codec = array.codecType();
  out.stride = array.stride();
  if (out.type == "int8") return AppendValues<std::int8_t>(array, out);
  if (out.type == "int16") return AppendValues<std::int16_t>(array, out);
  if (out.type == "int32") return AppendValues<std::int32_t>(array, out);
  if (out.type == "int64") return AppendValues<std::int64_t>(array, out);
  if (out.type == "float") return AppendValues<float>(array, out);
  if (out.type == "double") return AppendValues<double>(array, out);
  if (out.type == "vec3s") return AppendValues<openvdb::Vec3f>(array, out);
  if (out.type == "vec3d") return AppendValues<openvdb::Vec3d>(array, out);
  throw std::runtime_error("an attribute of type " + out.type);
}

void AppendLeaf(const Leaf& leaf, const openvdb::math::Transform& transform, VdbPoints& out) {
  leaf.validateOffsets();
  const points::AttributeHandle<openvdb::Vec3f> place(leaf.constAttributeArray("P"));
  for (auto index = leaf.beginIndexOn(); index; ++index) {
    const openvdb::Coord voxel = index.getCoord();
    const openvdb::Vec3d in_voxel = place.get(*index);
    out.voxel.push_back({voxel.x(), voxel.y(), voxel.z()});
    out.in_voxel.push_back(ToVec3(in_voxel));
    out.position.push_back(ToVec3(transform.indexToWorld(in_voxel + voxel.asVec3d())));
  }
  for (const std::string& name : out.names) {
    Append(leaf.constAttributeArray(name), out.attributes[name]);
  }
}

}  // namespace

VdbPoints ReadVdb(const std::string& path) {
  openvdb::initialize();
  openvdb::io::File file(path);
  file.open(/*delayLoad=*/false);
  const auto grids = file.getGrids();
  VdbPoints out;
  for (const auto& grid : *grids) out.grids.push_back(grid->getName());
  const auto grid = openvdb::gridPtrCast<points::PointDataGrid>(grids->at(0));
  if (grid == nullptr) throw std::runtime_error(path + ": no grid of points");
  out.type = grid->type();
  out.creator = grid->getCreator();
  out.edge = grid->voxelSize().x();
  out.first_voxel = ToVec3(grid->indexToWorld(openvdb::Coord(0, 0, 0)));
  out.active_voxels = grid->activeVoxelCount();
  for (auto each = grid->beginMeta(); each != grid->endMeta(); ++each) {
    if (each->second->typeName() == "string") out.metadata[each->first] = each->second->str();
  }
  const auto first = grid->tree().cbeginLeaf();
  if (!first) return out;
  out.names.resize(first->attributeSet().size());
  for (const auto& [name, place] : first->attributeSet().descriptor().map())
    out.names[place] = name;
  for (auto leaf = grid->tree().cbeginLeaf(); leaf; ++leaf) {
    AppendLeaf(*leaf, grid->transform(), out);
  }
  return out;
}

}  // namespace strata::test
