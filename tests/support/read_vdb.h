// A vdb's points as plain arrays, read by OpenVDB's own library.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "core/vec3.h"

namespace strata::test {

struct VdbPoints {
  struct Attribute {
    std::string type, codec;   ///< As OpenVDB names them: "vec3s", "null".
    std::uint32_t stride = 1;  ///< Values a point.
    std::size_t point_bytes = 0;
    std::vector<char> bytes;  ///< Decoded values of all points.
  };

  std::vector<std::string> grids;  ///< Names of all grids in the file; the rest is the first's.
  std::string type, creator;
  double edge = 0;
  Vec3 first_voxel;                             ///< Where the middle of voxel (0,0,0) is.
  std::map<std::string, std::string> metadata;  ///< Of the grid; what is text.
  std::uint64_t active_voxels = 0;

  std::vector<Cell> voxel;         ///< Of each point, in the order of the file.
  std::vector<Vec3> in_voxel;      ///< P: from the middle, in edges.
  std::vector<Vec3> position;      ///< World units, by the grid's own transform.
  std::vector<std::string> names;  ///< Of the attributes, in order, P first.
  std::map<std::string, Attribute> attributes;

  std::size_t size() const { return voxel.size(); }
  template <class T>
  T At(const std::string& name, std::size_t point, std::size_t k = 0) const {
    const Attribute& attribute = attributes.at(name);
    T value;
    std::memcpy(&value, attribute.bytes.data() + point * attribute.point_bytes + k * sizeof(T),
                sizeof(T));
    return value;
  }
};

/// Throws what OpenVDB throws, and std::runtime_error when the first grid is none of points.
VdbPoints ReadVdb(const std::string& path);

}  // namespace strata::test
