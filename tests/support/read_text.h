// A whole file as a string.
#pragma once

#include <fstream>
#include <iterator>
#include <string>

namespace strata::test {

/// Empty when the file cannot be read.
inline std::string ReadText(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

}  // namespace strata::test
