#include "server/batch/former_lines.h"

#include <algorithm>
#include <filesystem>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "server/batch/bucket_output.h"

namespace strata::server {

Result<FormerLines> FormerLines::Open(const std::string& state, const std::string& own_name,
                                      Manifest& own) {
  FormerLines lines(own);
  std::vector<std::string> names;
  std::error_code failed;
  for (std::filesystem::directory_iterator at(state, failed), end; !failed && at != end;
       at.increment(failed)) {
    std::string name = at->path().filename().string();
    if (name != own_name && IsBatchManifest(name)) names.push_back(std::move(name));
  }
  if (failed) return Fail(ErrorCode::kIo, state + ": " + failed.message());
  std::ranges::sort(names);
  for (const std::string& name : names) {
    auto reader = ManifestReader::Open(state + '/' + name);
    if (!reader) return Forward(reader);
    lines.others_.push_back(*std::move(reader));
  }
  return lines;
}

Result<std::vector<ManifestLine>> FormerLines::Of(const std::string& path) const {
  std::vector<ManifestLine> lines;
  const auto add = [&lines](Result<std::optional<ManifestLine>> line) -> Result<void> {
    if (!line) return Forward(line);
    if (*line && !(*line)->gone) lines.push_back(**std::move(line));
    return {};
  };
  if (auto added = add(own_->Find(path)); !added) return Forward(added);
  for (const ManifestReader& each : others_) {
    if (auto added = add(each.Find(path)); !added) return Forward(added);
  }
  return lines;
}

bool FormerLines::IsElsewhere(const std::string& path) const {
  return std::ranges::any_of(others_, [&](const ManifestReader& each) { return each.Has(path); });
}

std::vector<std::string> FormerLines::Paths() const {
  std::set<std::string> paths;
  const auto add = [&paths](std::vector<std::string> more) {
    paths.insert(std::move_iterator(more.begin()), std::move_iterator(more.end()));
  };
  add(own_->Paths());
  for (const ManifestReader& each : others_) add(each.Paths());
  return {paths.begin(), paths.end()};
}

bool IsOverruled(const ManifestLine& line, const std::vector<ManifestLine>& lines) {
  return std::ranges::any_of(lines, [&line](const ManifestLine& other) {
    return other.measured.finished > line.measured.finished && other.output == line.output &&
           other.output_sha256 != line.output_sha256;
  });
}

}  // namespace strata::server
