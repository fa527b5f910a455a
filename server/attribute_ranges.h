// Which values the attributes of a mesh take.
#pragma once

#include <string>
#include <vector>

#include "core/mesh_attributes.h"
#include "core/mesh_reader.h"
#include "core/result.h"
#include "core/run_context.h"

namespace strata::server {

/// An attribute and, component by component, its least and largest number at the corners of
/// triangles (NaN aside; 64-bit integers to 53 bits). Both empty if they were not looked for, as
/// those of textures never are, or if there is no triangle.
struct AttributeRange {
  MeshAttribute attribute;
  std::vector<double> min, max;
  std::string fault;  ///< Why they could not be read; "" if they could, or were not looked for.
};

/// Reads the attributes of `values` once, at the corners of the triangles that `triangles`, another
/// reader of the same mesh, gives. Errors: theirs; kCancelled.
Result<std::vector<AttributeRange>> FindRanges(MeshReader& triangles, MeshReader& values,
                                               RunContext& context);

}  // namespace strata::server
