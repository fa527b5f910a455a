// Attributes of a mesh at points, for tests.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <string>
#include <vector>

#include "core/mesh_reader.h"
#include "core/run_context.h"

namespace strata::test {

/// The number of the attribute with this name.
inline std::size_t NumberOf(const MeshReader& reader, const std::string& name) {
  const auto attributes = reader.attributes();
  for (std::size_t k = 0; k < attributes.size(); ++k) {
    if (attributes[k].name == name) return k;
  }
  ADD_FAILURE() << "no attribute " << name << " among " << Describe(attributes);
  return 0;
}

/// The values of one attribute at these points, components one after the other.
template <class T>
std::vector<T> ValuesAt(MeshReader& reader, const std::string& name,
                        const std::vector<SurfacePoint>& points) {
  const std::size_t number[] = {NumberOf(reader, name)};
  const MeshAttribute& attribute = reader.attributes()[number[0]];
  EXPECT_EQ(attribute.bytes(), sizeof(T) * static_cast<std::size_t>(attribute.components));
  RunContext context;
  auto pass = reader.ReadAttributes(number, context);
  EXPECT_TRUE(pass) << pass.error().message;
  std::vector<T> values(points.size() * static_cast<std::size_t>(attribute.components));
  if (!pass) return values;
  char* const out[] = {reinterpret_cast<char*>(values.data())};
  const auto read = (*pass)->Read(points, out);
  EXPECT_TRUE(read) << read.error().message;
  return values;
}

}  // namespace strata::test
