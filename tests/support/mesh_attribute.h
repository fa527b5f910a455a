// Attributes for the tests, in few words.
#pragma once

#include "core/mesh_attributes.h"

namespace strata::test {

inline MeshAttribute MakeAttribute(const char* name, ScalarType type, int components,
                                   Semantic semantic = Semantic::kGeneric) {
  MeshAttribute attribute;
  attribute.name = name;
  attribute.type = type;
  attribute.components = components;
  attribute.semantic = semantic;
  return attribute;
}

}  // namespace strata::test
