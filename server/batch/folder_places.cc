#include "server/batch/folder_places.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>
#include <utility>

#include "io/detect_format.h"
#include "io/fd.h"
#include "io/output_place.h"
#include "io/sample_writer.h"
#include "server/batch/glob.h"

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

bool IsPath(const std::string& path) {
  if (path.empty() || path.find('\0') != path.npos) return false;
  for (std::size_t begin = 0; begin <= path.size();) {
    const std::size_t end = std::min(path.find('/', begin), path.size());
    const std::string segment = path.substr(begin, end - begin);
    if (segment.empty() || segment == "." || segment == "..") return false;
    begin = end + 1;
  }
  return true;
}

std::string StampOf(const struct stat& status) {
  const auto nanoseconds = std::to_string(1'000'000'000 + status.st_mtim.tv_nsec).substr(1);
  return std::to_string(status.st_mtim.tv_sec) + '.' + nanoseconds + ' ' +
         std::to_string(status.st_ino);
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
    if (!IsPath(path)) return std::optional<ModelEntry>();
    struct stat status {};
    if (stat(Joined(folder_, path).c_str(), &status) != 0) {
      if (errno == ENOENT || errno == ENOTDIR || errno == ELOOP) return std::optional<ModelEntry>();
      return FailSystem(NameOf(path), errno);
    }
    if (!S_ISREG(status.st_mode) || !IsBelow(Resolved(Joined(folder_, path)), root_)) {
      return std::optional<ModelEntry>();
    }
    return std::optional(EntryOf(path, status));
  }

  Result<LocalModel> Fetch(const ModelEntry& model, const std::function<bool()>&) override {
    return LocalModel{Joined(folder_, model.path), nullptr};
  }

  Result<std::optional<std::string>> ReadText(const std::string& path) override {
    constexpr std::size_t kMost = std::size_t{1} << 20;
    const auto found = Find(path);
    if (!found) return Forward(found);
    if (!*found) return std::optional<std::string>();
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
      const fs::file_type type = at->symlink_status(unknown).type();
      if (type == fs::file_type::directory) {
        if (Resolved(at->path().string()) != outputs_) folders.push_back(path);
      } else if (type == fs::file_type::regular && Takes(filter, path)) {
        struct stat status {};
        if (lstat(at->path().c_str(), &status) == 0) models.push_back(EntryOf(path, status));
      } else if (type == fs::file_type::symlink && Takes(filter, path)) {
        auto found = Find(path);
        if (!found) return Forward(found);
        if (*found) models.push_back(**std::move(found));
      }
    }
    return failed ? Result<void>(FailSystem(place, failed.value())) : Result<void>();
  }

  const std::string folder_;
  const fs::path root_, outputs_;
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
    const fs::file_type type = fs::symlink_status(path, failed).type();
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

bool Takes(const ModelFilter& filter, std::string_view path) {
  if (path.starts_with('.') || path.find("/.") != path.npos) return false;
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
