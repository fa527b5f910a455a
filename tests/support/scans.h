// The scans of the data folder, which are not part of the repository.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>

#include "io/open_mesh.h"
#include "tests/support/test_data.h"

namespace strata::test {

/// Where a scan lies, or an empty path if it is not there. Needs STRATA_SOURCE_DIR.
inline std::filesystem::path ScanPath(const std::string& name) {
  const auto path = TestDataFolder(STRATA_SOURCE_DIR) / "scans" / name;
  return std::filesystem::exists(path) ? path : std::filesystem::path();
}

inline std::unique_ptr<MeshReader> OpenScan(const std::filesystem::path& path) {
  auto reader = io::OpenMesh(path.string());
  if (!reader) {
    ADD_FAILURE() << reader.error().message;
    return nullptr;
  }
  return std::move(*reader);
}

/// Names a scan for the rest of the test as `path`, or skips the test.
#define STRATA_SCAN_OR_SKIP(path, name)                              \
  const std::filesystem::path path = ::strata::test::ScanPath(name); \
  if (path.empty())                                                  \
  GTEST_SKIP() << name                                               \
               << " is not there: set STRATA_TEST_DATA to "          \
                  "a folder that holds scans/"

}  // namespace strata::test
