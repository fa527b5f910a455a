// Runs a fuzz target's entry point on files and on every folder of files given: an ordinary test
// for builds without libFuzzer.
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

void RunFile(const std::filesystem::path& path) {
  std::ifstream in(path, std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  // A copy of the exact size, so that a sanitizer sees a read beyond its end; then damaged copies.
  std::vector<std::uint8_t> copy(bytes.begin(), bytes.end());
  LLVMFuzzerTestOneInput(copy.data(), copy.size());
  for (std::size_t i = 0; i < copy.size(); ++i) {
    const std::uint8_t kept = copy[i];
    copy[i] = static_cast<std::uint8_t>(kept ^ (1u << (i % 8)));
    LLVMFuzzerTestOneInput(copy.data(), copy.size());
    copy[i] = kept;
  }
}

}  // namespace

int main(int argc, char** argv) {
  int files = 0;
  for (int i = 1; i < argc; ++i) {
    for (const auto& entry : std::filesystem::recursive_directory_iterator(argv[i])) {
      if (!entry.is_regular_file()) continue;
      RunFile(entry.path());
      ++files;
    }
  }
  std::printf("%d seeds\n", files);
  return files > 0 ? 0 : 1;
}
