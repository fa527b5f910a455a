// Writes the man pages and the shells' completions. Part of the build; not installed.
//
// usage: strata_pages FOLDER VERSION DATE
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "server/command_line.h"
#include "server/pages/completion.h"
#include "server/pages/man_page.h"
#ifdef STRATA_SERVICE
#include "server/batch/batch_config.h"
#include "server/serve_config.h"
#include "server/service_tools.h"
#endif

namespace strata::server {
namespace {

/// `strata` itself, then its commands in the order of its help.
std::vector<CommandText> AllCommands() {
  std::vector<CommandText> all = DescribeCommands();
#ifdef STRATA_SERVICE
  all.push_back(DescribeServe());
  all.push_back(DescribeServe(ServeMode::kWorker));
  for (CommandText& each : DescribeServiceTools()) all.push_back(std::move(each));
  for (CommandText& each : DescribeBatchCommands()) all.push_back(std::move(each));
#endif
  return all;
}

bool Write(const std::filesystem::path& path, const std::string& text) {
  std::error_code failed;
  std::filesystem::create_directories(path.parent_path(), failed);
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) std::fprintf(stderr, "%s: cannot be written\n", path.c_str());
  return static_cast<bool>(file);
}

int Main(const std::filesystem::path& folder, const PageEdge& edge) {
  const std::vector<CommandText> all = AllCommands();
  bool good = true;
  for (const CommandText& each : all) {
    good &= Write(folder / "man" / (PageName(each) + ".1"), ManPage(each, all, edge));
  }
  good &= Write(folder / "completion" / "strata", BashCompletion(all));
  good &= Write(folder / "completion" / "_strata", ZshCompletion(all));
  good &= Write(folder / "completion" / "strata.fish", FishCompletion(all));
  return good ? 0 : 1;
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  if (argc != 4) {
    std::fputs("usage: strata_pages FOLDER VERSION DATE\n", stderr);
    return 2;
  }
  return strata::server::Main(argv[1], {argv[2], argv[3]});
}
