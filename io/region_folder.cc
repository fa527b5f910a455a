#include "io/region_folder.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <sstream>
#include <utility>

#include "io/atomic_file.h"
#include "io/atomic_folder.h"
#include "io/output_place.h"
#include "io/tile_place.h"
#include "io/tileset_json.h"

namespace strata::io {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kJobName = "job.json";
constexpr const char* kFragmentPrefix = "region-";
// The tiles: "folder" until a process claims it in order to publish it.
constexpr const char* kFolderName = "folder";
constexpr const char* kClaimPrefix = "claimed-";
// Processes that publish at once may take the folder from each other, but each time one of them has
// come further.
constexpr int kTries = 1000;

std::string FragmentName(std::uint32_t region) {
  return kFragmentPrefix + std::to_string(region) + ".txt";
}

std::string UniqueName(const std::string& prefix) {
  const std::string name = NewTemporaryName("x", TemporaryKind::kFile);
  const std::size_t digits = name.find(".strata-") + 8;
  return prefix + name.substr(digits, 16);
}

// All of a small file, or nothing where there is none.
std::string ReadWhole(int folder, const std::string& name, std::size_t most) {
  const int file = openat(folder, name.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
  std::string bytes;
  while (file >= 0 && bytes.size() < most) {
    char buffer[1 << 14];
    const ssize_t n = read(file, buffer, std::min(sizeof buffer, most - bytes.size()));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) break;
    bytes.append(buffer, static_cast<std::size_t>(n));
  }
  if (file >= 0) close(file);
  return bytes;
}

bool Exists(int folder, const std::string& name) {
  return faccessat(folder, name.c_str(), F_OK, AT_SYMLINK_NOFOLLOW) == 0;
}

Json Parsed(const std::string& text) {
  Json json = Json::parse(text, nullptr, false);
  return json.is_discarded() ? Json(text) : json;
}

// What processes must agree on, so that a difference can be named.
std::string JobText(const SharedOutput& output) {
  Json json = {{"format", "strata-regions"},
               {"version", 1},
               {"regions", output.region.count},
               {"mesh", output.mesh},
               {"tile_samples", output.tile_samples},
               {"attributes", output.header.attributes},
               {"position_error", output.header.position_error},
               {"samples", Parsed(output.header.provenance)}};
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + '\n';
}

// The first thing in which two jobs differ.
std::string Difference(const std::string& theirs, const std::string& ours) {
  const Json a = Parsed(theirs).flatten(), b = Parsed(ours).flatten();
  for (const auto& [key, value] : b.items()) {
    if (a.contains(key) && a[key] == value) continue;
    return key.substr(1) + " is " + (a.contains(key) ? a[key].dump() : "absent") + " there, here " +
           value.dump();
  }
  return "it says more";
}

}  // namespace

// The tiles of one region.
class RegionFolder::Place final : public TilePlace {
 public:
  Place(const RegionFolder& folder, std::uint64_t samples) : folder_(folder), samples_(samples) {}
  Result<void> AddTile(const std::string& path, std::string_view bytes) override {
    bytes_ += bytes.size();
    return folder_.PutTile(path, bytes);
  }
  Result<std::uint64_t> Finish(const std::vector<std::string>& entries) override {
    const auto fragment = folder_.PutFragment(samples_, entries);
    if (!fragment) return fragment;
    return bytes_ + *fragment;
  }
  const std::string& name() const override { return folder_.output_.path; }

 private:
  const RegionFolder& folder_;
  std::uint64_t samples_, bytes_ = 0;
};

tl::unexpected<Error> RegionFolder::FailIo(const std::string& what, int error) const {
  return Fail(ErrorCode::kIo, output_.path + ".regions: " + what + ": " + SystemReason(error));
}

Result<std::unique_ptr<RegionFolder>> RegionFolder::Open(const SharedOutput& output) {
  const auto head = HeadOfTiles(output.path, output.header, output.tile_samples);
  if (!head) return Forward(head);
  std::unique_ptr<RegionFolder> folder(new RegionFolder(output));
  folder->head_ = *head;
  folder->job_ = JobText(output);
  if (auto started = folder->Start(); !started) return Forward(started);
  return folder;
}

RegionFolder::~RegionFolder() {
  if (folder_ >= 0) close(folder_);
  if (parent_ >= 0) close(parent_);
}

Result<void> RegionFolder::Start() {
  const std::string target = ResolveLinks(output_.path);
  final_name_ = target.substr(target.rfind('/') + 1);
  if (final_name_.empty() || final_name_ == "." || final_name_ == ".." ||
      IsWrittenThrough(output_.path)) {
    return Fail(ErrorCode::kInvalidArgument, output_.path + ": expected the name of a folder");
  }
  work_ = final_name_ + ".regions";
  parent_ = open(FolderOf(target).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (parent_ < 0) return FailIo("cannot open the folder it is to stand in", errno);
  const std::string why_not = WhyNotReplaceable(parent_, final_name_, kTilesetName);
  if (!why_not.empty()) {
    return Fail(ErrorCode::kInvalidArgument, output_.path + ": " + why_not);
  }
  for (int attempt = 0; attempt < kTries; ++attempt) {
    if (IsFinished()) {
      RemoveWork();
      return {};
    }
    const auto opened = TryToOpenWork();
    if (!opened) return Forward(opened);
    if (*opened) return CheckJob();
    if (auto created = CreateWork(); !created) return created;
  }
  return FailIo("it comes and goes", EBUSY);
}

Result<bool> RegionFolder::TryToOpenWork() {
  folder_ = openat(parent_, work_.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  if (folder_ >= 0) return true;
  if (errno == ENOENT) return false;
  return FailIo("cannot open it", errno);
}

// All of it at once, so that a folder of this name always says what it is for.
Result<void> RegionFolder::CreateWork() {
  const std::string path = FolderOf(ResolveLinks(output_.path)) + "/" + work_;
  auto folder = AtomicFolder::Open(path, kJobName);
  if (!folder) return Forward(folder);
  Result<void> done = (*folder)->AddFolder(kFolderName);
  if (done) done = (*folder)->AddFolder(std::string(kFolderName) + "/" + kTilesFolder);
  if (done) done = (*folder)->AddFile(kJobName, job_);
  if (!done) return done;
  const auto first = (*folder)->FinishIfFree();
  return first ? Result<void>() : Forward(first);
}

Result<void> RegionFolder::CheckJob() const {
  const std::string found = ReadWhole(folder_, kJobName, std::size_t{1} << 24);
  // Another process may have finished and removed it meanwhile.
  if (found == job_ || IsFinished()) return {};
  const std::string folder = output_.path + ".regions";
  if (found.empty()) {
    return Fail(ErrorCode::kInvalidArgument,
                folder + ": found a folder without " + kJobName + ", expected one of regions");
  }
  return Fail(ErrorCode::kInvalidArgument,
              folder + ": another merge is under way there: " + Difference(found, job_) +
                  "; let it finish, or remove the folder");
}

bool RegionFolder::IsFinished() const {
  const std::string manifest = final_name_ + "/" + kTilesetName;
  return BeginsWithHead(ReadWhole(parent_, manifest, head_.size() + 64), head_);
}

bool RegionFolder::IsRegionDone() const {
  return folder_ >= 0 && Exists(folder_, FragmentName(output_.region.index));
}

Result<std::unique_ptr<SampleWriter>> RegionFolder::Write(const SampleHeader& header,
                                                          const WriterResources& resources) {
  if (auto checked = CheckTiles(output_.path, header, resources); !checked) {
    return Forward(checked);
  }
  return MakeTileWriter(std::make_unique<Place>(*this, header.count), header, resources);
}

Result<void> RegionFolder::WriteNothing() {
  auto put = PutFragment(0, {});
  return put ? Result<void>() : Forward(put);
}

Result<void> RegionFolder::PutFile(const std::string& name, std::string_view bytes) const {
  auto file = AtomicFile::OpenIn(folder_, name, output_.path + ".regions/" + name);
  if (!file) return Forward(file);
  if (auto written = (*file)->Write(bytes); !written) return written;
  const auto finished = (*file)->Finish();
  return finished ? Result<void>() : Forward(finished);
}

// First under a name of its own, outside of the tiles' folder, which may be given its final name at
// any moment if another process did the region as well: nothing unfinished may lie there.
Result<void> RegionFolder::PutTile(const std::string& path, std::string_view bytes) const {
  const std::string name = UniqueName("tile-");
  if (auto put = PutFile(name, bytes); !put) return put;
  const std::string final_path = std::string(kFolderName) + "/" + path;
  if (renameat(folder_, name.c_str(), folder_, final_path.c_str()) == 0) return {};
  const int error = errno;
  unlinkat(folder_, name.c_str(), 0);
  return FailIo("cannot put " + path + " in its place", error);
}

Result<std::uint64_t> RegionFolder::PutFragment(std::uint64_t samples,
                                                const std::vector<std::string>& entries) const {
  const std::string tiles = std::string(kFolderName) + "/" + kTilesFolder;
  if (const int error = SyncFolder(folder_, tiles.c_str()); error != 0) {
    return FailIo("cannot sync the tiles to disk", error);
  }
  std::string text = std::to_string(samples) + ' ' + std::to_string(entries.size()) + '\n';
  for (const std::string& entry : entries) text += entry + '\n';
  if (auto put = PutFile(FragmentName(output_.region.index), text); !put) return Forward(put);
  return text.size();
}

std::uint32_t RegionFolder::FragmentCount() const {
  std::uint32_t count = 0;
  for (std::uint32_t r = 0; r < output_.region.count; ++r) {
    count += Exists(folder_, FragmentName(r)) ? 1 : 0;
  }
  return count;
}

Result<std::uint32_t> RegionFolder::Commit() {
  for (int attempt = 0; attempt < kTries; ++attempt) {
    if (IsFinished()) {
      RemoveWork();
      return output_.region.count;
    }
    const std::uint32_t fragments = FragmentCount();
    if (fragments < output_.region.count) {
      // Or all of them are gone, because another process has just published.
      if (IsFinished()) continue;
      return fragments;
    }
    if (auto tried = TryToPublish(); !tried) return Forward(tried);
  }
  return FailIo("the finished folder cannot be given its name, others take it away", EBUSY);
}

Result<std::string> RegionFolder::Manifest() const {
  std::vector<std::string> entries;
  std::uint64_t count = 0;
  for (std::uint32_t r = 0; r < output_.region.count; ++r) {
    std::istringstream in(ReadWhole(folder_, FragmentName(r), std::size_t{1} << 32));
    std::uint64_t samples = 0, tiles = 0, lines = 0;
    std::string line;
    in >> samples >> tiles;
    std::getline(in, line);
    for (; std::getline(in, line); ++lines) entries.push_back(line);
    if (lines != tiles || (samples == 0) != (tiles == 0)) {
      return Fail(ErrorCode::kCorruptInput, output_.path + ".regions/" + FragmentName(r) +
                                                ": found " + std::to_string(lines) +
                                                " tiles, expected " + std::to_string(tiles));
    }
    count += samples;
  }
  SampleHeader header = output_.header;
  header.count = count;
  auto head = HeadOfTiles(output_.path, header, output_.tile_samples);
  if (!head) return Forward(head);
  return TilesetText(std::move(*head), entries);
}

// Gives the folder a name that no other process knows: whoever has it under such a name publishes.
// One who was killed meanwhile loses it to the next, and one who is only slow, too.
bool RegionFolder::Claim(const std::string& claim) const {
  if (renameat(folder_, kFolderName, folder_, claim.c_str()) == 0) return true;
  for (const std::string& other : NamesIn(folder_)) {
    if (other.starts_with(kClaimPrefix) &&
        renameat(folder_, other.c_str(), folder_, claim.c_str()) == 0) {
      return true;
    }
  }
  return false;
}

// What was claimed may be the output that another process has just replaced.
bool RegionFolder::IsOurs(const std::string& claim) const {
  if (!Exists(folder_, claim + "/" + kTilesFolder)) return false;
  const std::string manifest = claim + "/" + kTilesetName;
  return !Exists(folder_, manifest) ||
         BeginsWithHead(ReadWhole(folder_, manifest, head_.size() + 64), head_);
}

// False = another process was quicker at one of the steps.
Result<bool> RegionFolder::TryToPublish() {
  const auto manifest = Manifest();
  if (!manifest) {
    if (FragmentCount() < output_.region.count) return false;  // They went while they were read.
    return Forward(manifest);
  }
  const std::string name = UniqueName("manifest-"), claim = UniqueName(kClaimPrefix);
  if (auto put = PutFile(name, *manifest); !put) {
    if (IsFinished()) return false;
    return Forward(put);
  }
  if (!Claim(claim) || !IsOurs(claim)) return false;
  const std::string in_claim = claim + "/" + kTilesetName;
  const auto failed = [&](const std::string& what, int error) -> Result<bool> {
    if (error == ENOENT) return false;
    return FailIo(what, error);
  };
  if (renameat(folder_, name.c_str(), folder_, in_claim.c_str()) != 0) {
    return failed("cannot put the manifest in its place", errno);
  }
  int error = SyncFolder(folder_, claim.c_str());
  if (error != 0) return failed("cannot sync to disk", error);
  const Replacement named = GiveFinalName(folder_, claim, parent_, final_name_);
  if (named.error != 0) return failed("cannot give the finished folder its name", named.error);
  if (fsync(parent_) != 0 && errno != EINVAL) return FailIo("cannot sync to disk", errno);
  if (!named.replaced.empty()) {
    RemoveTree(named.replaced == claim ? folder_ : parent_, named.replaced.c_str());
  }
  return true;
}

// Only once the output is there. Under another name first, so that a process that still writes here
// is not in the way of the next output; what it adds while the folder is emptied, it removes itself
// when it comes here: the name is that of a leftover.
void RegionFolder::RemoveWork() {
  if (folder_ < 0) static_cast<void>(TryToOpenWork());
  // Where an output stands already, the work of another may have begun.
  if (folder_ >= 0 && ReadWhole(folder_, kJobName, job_.size() + 1) == job_) GiveWorkAway();
  RemoveLeftovers(parent_);
}

void RegionFolder::GiveWorkAway() {
  if (!NameRefersTo(parent_, work_.c_str(), folder_)) return;
  const std::string name = NewTemporaryName(final_name_, TemporaryKind::kFolder);
  if (renameat(parent_, work_.c_str(), parent_, name.c_str()) != 0) return;
  if (!NameRefersTo(parent_, name.c_str(), folder_)) {  // The next output's, just this moment.
    renameat(parent_, name.c_str(), parent_, work_.c_str());
  }
}

}  // namespace strata::io
