// What writers say of the columns that the mesh's attributes became.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/mesh_attributes.h"

namespace strata::io {

/// What each component is called where components are columns of their own (PLY, text). The first
/// colour is red, green, blue and alpha, the first UV s and t; of others the column's name comes
/// first. All names differ, and differ from those of the fixed columns.
std::vector<std::vector<std::string>> ComponentNames(std::span<const MeshAttribute> columns);

/// {"name":…,"type":…,"components":…} and, where they say something, "semantic", "set",
/// "color_space" and "normalized": one line of JSON, without the table of names.
std::string ColumnJson(const MeshAttribute& column);
/// An array of all of them.
std::string ColumnsJson(std::span<const MeshAttribute> columns);
/// The table of names as a JSON array on one line. What is not UTF-8 becomes U+FFFD.
std::string NamesJson(const MeshAttribute& column);
/// One name as a JSON string.
std::string NameJson(const std::string& name);

}  // namespace strata::io
