// The collection of meshes that lies outside the repository.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace strata::test {

/// The folder with the meshes and their INDEX.tsv: $STRATA_TEST_DATA, or beside the sources.
/// `source_dir` is the repository. May not exist.
inline std::filesystem::path TestDataFolder(const std::filesystem::path& source_dir) {
  const char* const variable = std::getenv("STRATA_TEST_DATA");
  return variable != nullptr ? std::filesystem::path(variable) : source_dir / "../shared/data";
}

/// A row of INDEX.tsv. Counts and bounds are empty where the index gives none.
struct IndexedFile {
  std::string path, format, vertices, faces, triangles, bounds, notes;
};

inline std::vector<IndexedFile> ReadIndex(const std::filesystem::path& folder) {
  std::vector<IndexedFile> files;
  std::ifstream in(folder / "INDEX.tsv");
  std::string line;
  std::getline(in, line);
  while (std::getline(in, line)) {
    std::vector<std::string> field(14);
    std::istringstream row(line);
    for (std::string& f : field) std::getline(row, f, '\t');
    files.push_back({field[0], field[5], field[8], field[9], field[10], field[11], field[12]});
  }
  return files;
}

}  // namespace strata::test
