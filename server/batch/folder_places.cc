#include "server/batch/folder_places.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <system_error>
#include <utility>

#include "io/detect_format.h"
#include "io/fd.h"
#include "io/output_place.h"
#include "io/sample_writer.h"
#include "server/batch/glob.h"
#include "server/service/file_stamp.h"

namespace strata::server {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> FailSystem(const std::string& name, int error) {
  return Fail(error == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo,
              name + ": " + io::SystemReason(error));
}

std::string Joined(const std::string& folder, const std::string& path) {
  if (path.empty()) return folder;
  return folder.ends_with('/') ? folder + path : folder + '/' + path;
}

/// Without links, "." and "..", as far as it exists.
fs::path Resolved(const std::string& path) {
  std::error_code failed;
  fs::path resolved = fs::weakly_canonical(fs::absolute(path, failed), failed);
  if (failed) resolved = path;
  return resolved.has_filename() ? resolved : resolved.parent_path();
}

bool IsBelow(const fs::path& path, const fs::path& folder) {
  return std::mismatch(folder.begin(), folder.end(), path.begin(), path.end()).first ==
         folder.end();
}

ModelEntry EntryOf(const std::string& path, const struct stat& status) {
  return {path, static_cast<std::uint64_t>(status.st_size), StampOf(status)};
}

class FolderSource final : public ModelSource {
 public:
  FolderSource(std::string folder, const std::string& outputs)
      : folder_(std::move(folder)), root_(Resolved(folder_)), outputs_(Resolved(outputs)) {}

  Result<void> Check() const {
    std::error_code failed;
    if (!fs::exists(root_, failed)) {
      return Fail(ErrorCode::kNotFound, folder_ + ": no such folder");
    }
    if (!fs::is_directory(root_, failed)) {
      return Fail(ErrorCode::kInvalidArgument, folder_ + ": found a file, expected a folder");
    }
    if (IsBelow(root_, outputs_)) {
      return Fail(ErrorCode::kInvalidArgument,
                  "the outputs would mix with the models of " + folder_ + ": name another folder");
    }
    return {};
  }

  Result<std::vector<ModelEntry>> List(const ModelFilter& filter) override {
    std::vector<ModelEntry> models;
    std::vector<std::string> folders = {""};
    while (!folders.empty()) {
      const std::string folder = std::move(folders.back());
      folders.pop_back();
      if (auto listed = ListFolder(folder, filter, folders, models); !listed) {
        return Forward(listed);
      }
    }
    return models;
  }

  Result<std::optional<ModelEntry>> Find(const std::string& path) override {
    if (!IsModelPath(path)) return std::optional<ModelEntry>();
    struct stat status {};
    if (stat(Joined(folder_, path).c_str(), &status) != 0) {
      constexpr std::array kNothing = {ENOENT, ENOTDIR, ELOOP, ENAMETOOLONG};
      if (std::ranges::find(kNothing, errno) != kNothing.end()) return std::optional<ModelEntry>();
      return FailSystem(NameOf(path), errno);
    }
    if (!S_ISREG(status.st_mode) || !IsBelow(Resolved(Joined(folder_, path)), root_)) {
      return std::optional<ModelEntry>();
    }
    return std::optional(EntryOf(path, status));
  }

  Result<LocalModel> Fetch(const ModelEntry& model, const std::function<bool()>&) override {
    const auto fault = faults_.find(model.path);
    if (fault != faults_.end()) return tl::unexpected<Error>(fault->second);
    return LocalModel{Joined(folder_, model.path), nullptr};
  }

  Result<std::optional<std::string>> ReadText(const std::string& path) override {
    constexpr std::size_t kMost = std::size_t{1} << 20;
    const auto found = Find(path);
    if (!found) return Forward(found);
    if (!*found) {
      struct stat status {};
      if (lstat(Joined(folder_, path).c_str(), &status) != 0) return std::optional<std::string>();
      return tl::unexpected<Error>(NotRead(path, "found what is no file below " + folder_));
    }
    if ((*found)->size > kMost) {
      return Fail(ErrorCode::kOverBudget, NameOf(path) + ": found " +
                                              std::to_string((*found)->size) +
                                              " bytes, expected at most 1048576");
    }
    std::ifstream file(Joined(folder_, path), std::ios::binary);
    std::string text((*found)->size, '\0');
    if (!file || !file.read(text.data(), static_cast<std::streamsize>(text.size()))) {
      return Fail(ErrorCode::kIo, NameOf(path) + ": cannot be read");
    }
    return std::optional(std::move(text));
  }

  std::string NameOf(const std::string& path) const override { return Joined(folder_, path); }

 private:
  /// What stands in a folder. Only the root has to be readable: of what is below it, that it cannot
  /// be read is one model's failure.
  Result<void> ListFolder(const std::string& folder, const ModelFilter& filter,
                          std::vector<std::string>& folders, std::vector<ModelEntry>& models) {
    std::error_code failed;
    const std::string place = Joined(folder_, folder);
    for (fs::directory_iterator at(place, failed), end; !failed && at != end;
         at.increment(failed)) {
      const std::string name = at->path().filename().string();
      if (name.starts_with('.')) continue;
      const std::string path = folder.empty() ? name : folder + '/' + name;
      std::error_code unknown;
      if (at->symlink_status(unknown).type() != fs::file_type::directory) {
        if (Takes(filter, path)) ListFile(path, models);
      } else if (!PassesOver(filter, path) && Resolved(at->path().string()) != outputs_) {
        folders.push_back(path);
      }
    }
    if (!failed) return {};
    auto fault = FailSystem(place, failed.value());
    if (folder.empty()) return fault;
    struct stat status {};  // Of one that is gone meanwhile, nothing needs to be said.
    if (lstat(place.c_str(), &status) == 0) ListFault(folder, status, fault.value(), models);
    return {};
  }

  /// A file, or what stands where one is expected.
  void ListFile(const std::string& path, std::vector<ModelEntry>& models) {
    struct stat status {};
    if (lstat(Joined(folder_, path).c_str(), &status) != 0) return;  // It is gone meanwhile.
    if (S_ISREG(status.st_mode)) return models.push_back(EntryOf(path, status));
    if (!S_ISLNK(status.st_mode)) {
      return ListFault(path, status, NotRead(path, "found a pipe, socket or device"), models);
    }
    auto found = Find(path);
    if (!found) return ListFault(path, status, found.error(), models);
    if (*found) return models.push_back(**std::move(found));
    struct stat target {};
    const bool leads = stat(Joined(folder_, path).c_str(), &target) == 0;
    if (leads && S_ISDIR(target.st_mode)) return;  // Its models stand elsewhere, or not in REPO.
    ListFault(path, status,
              NotRead(path, leads ? "found a link that leads out of " + folder_
                                  : "found a link that leads nowhere"),
              models);
  }

  Error NotRead(const std::string& path, const std::string& found) const {
    return {ErrorCode::kUnsupported, NameOf(path) + ": " + found + ", expected a file"};
  }

  /// Fetch will fail with `fault`, so that it stands in the manifest.
  void ListFault(const std::string& path, const struct stat& status, Error fault,
                 std::vector<ModelEntry>& models) {
    faults_[path] = std::move(fault);
    models.push_back(EntryOf(path, status));
    models.back().size = 0;
  }

  const std::string folder_;
  const fs::path root_, outputs_;
  std::map<std::string, Error> faults_;  // Of List; not changed later.
};

class FolderOutput final : public OutputPlace {
 public:
  explicit FolderOutput(std::string folder) : folder_(std::move(folder)) {}

  Result<std::string> OpenState() override {
    std::error_code failed;
    fs::create_directories(folder_, failed);
    if (failed) return FailSystem(folder_, failed.value());
    return folder_;
  }

  Result<std::string> LocalPath(const std::string& output) override {
    std::string path = Joined(folder_, output);
    std::error_code failed;
    fs::create_directories(io::FolderOf(path), failed);
    if (failed) return Fail(ErrorCode::kIo, io::FolderOf(path) + ": " + failed.message());
    return path;
  }

  Result<void> Publish(const std::string&, const std::function<bool()>&) override { return {}; }

  Result<bool> IsThere(const std::string& output, std::uint64_t size) override {
    std::error_code failed;
    const fs::path path = Joined(folder_, output);
    const fs::file_type type = fs::status(path, failed).type();  // Of a link, what is written to.
    if (type == fs::file_type::regular) return fs::file_size(path, failed) == size && !failed;
    if (type != fs::file_type::directory) return false;
    std::uint64_t bytes = 0;
    for (fs::recursive_directory_iterator at(path, failed), end; !failed && at != end;
         at.increment(failed)) {
      if (at->is_regular_file(failed)) bytes += at->file_size(failed);
    }
    return !failed && bytes == size;
  }

  Result<void> Remove(const std::string& output) override {
    const std::string path = Joined(folder_, output), base = fs::path(path).filename().string();
    const io::Fd folder(open(io::FolderOf(path).c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!folder) return {};
    if (io::IsMarkedFolder(folder.get(), base, io::kTilesetName)) {
      io::RemoveTree(folder.get(), base.c_str());
    } else if (unlinkat(folder.get(), base.c_str(), 0) != 0 && errno != ENOENT) {
      return FailSystem(path, errno);
    }
    RemoveEmptyFolders(output);
    return {};
  }

  void Discard(const std::string& output) override {
    DiscardIn(io::FolderOf(Joined(folder_, output)));
  }

  void DiscardAll() override {
    DiscardIn(folder_);
    std::error_code failed;
    std::vector<std::string> folders;
    for (fs::recursive_directory_iterator at(folder_, failed), end; !failed && at != end;
         at.increment(failed)) {
      if (at->symlink_status(failed).type() == fs::file_type::directory) {
        folders.push_back(at->path().string());
      }
    }
    for (const std::string& folder : folders) DiscardIn(folder);
  }

  std::string NameOf(const std::string& output) const override { return Joined(folder_, output); }

 private:
  static void DiscardIn(const std::string& place) {
    const io::Fd folder(open(place.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (folder) io::RemoveLeftovers(folder.get());
  }

  void RemoveEmptyFolders(const std::string& output) const {
    for (std::size_t end = output.rfind('/'); end != output.npos && end > 0;
         end = output.rfind('/', end - 1)) {
      if (rmdir(Joined(folder_, output.substr(0, end)).c_str()) != 0) return;
    }
  }

  const std::string folder_;
};

}  // namespace

bool IsModelPath(std::string_view path) {
  if (path.empty() || path.find('\0') != path.npos) return false;
  for (std::size_t begin = 0; begin <= path.size();) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    const std::string_view segment = path.substr(begin, end - begin);
    if (segment.empty() || segment == "." || segment == "..") return false;
    begin = end + 1;
  }
  return true;
}

bool PassesOver(const ModelFilter& filter, std::string_view folder) {
  return std::ranges::any_of(
      filter.exclude, [folder](const std::string& glob) { return MatchesAllBelow(glob, folder); });
}

bool IsHidden(std::string_view path) {
  return path.starts_with('.') || path.find("/.") != path.npos;
}

bool Takes(const ModelFilter& filter, std::string_view path) {
  if (IsHidden(path)) return false;
  if (!filter.all && !io::HasMeshSuffix(path)) return false;
  const auto matches = [path](const std::string& glob) { return MatchesGlob(glob, path); };
  if (std::ranges::any_of(filter.exclude, matches)) return false;
  return filter.include.empty() || std::ranges::any_of(filter.include, matches);
}

Result<std::unique_ptr<ModelSource>> OpenFolderSource(const std::string& folder,
                                                      const std::string& outputs) {
  auto source = std::make_unique<FolderSource>(folder, outputs);
  if (auto good = source->Check(); !good) return Forward(good);
  return source;
}

std::unique_ptr<OutputPlace> OpenFolderOutput(const std::string& folder) {
  return std::make_unique<FolderOutput>(folder);
}

}  // namespace strata::server
