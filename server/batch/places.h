// Where a batch finds its models and where its outputs go: folders, buckets.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata::server {

/// A model as its place lists it.
struct ModelEntry {
  /// Below the place's root, segments divided by '/': any bytes but NUL, no empty segment, no "."
  /// and no "..".
  std::string path;
  std::uint64_t size = 0;  ///< Bytes as stored.
  /// What tells a changed model from an unchanged one without reading it: equal stamps and sizes,
  /// equal bytes. The place's own words: a file's time and inode, an object's tag.
  std::string stamp;
};

/// Which of a place's files are models.
struct ModelFilter {
  std::vector<std::string> include, exclude;  ///< Globs over paths (batch/glob.h). No include: all.
  bool all = false;  ///< Every file, whatever its suffix; else those that io knows.
};

/// Whether the filter takes a path. Files and folders whose names begin with '.' are never models.
bool Takes(const ModelFilter& filter, std::string_view path);
/// Whether a glob of the filter leaves out whatever lies below a folder.
bool PassesOver(const ModelFilter& filter, std::string_view folder);
/// Whether a part of the path begins with '.'.
bool IsHidden(std::string_view path);
/// Whether it is a path as ModelEntry::path is: one that stays below its place.
bool IsModelPath(std::string_view path);

/// A model that can be read as a local file, as long as this lives.
struct LocalModel {
  std::string path;
  std::shared_ptr<void> keep;  ///< What removes a fetched copy when it goes; may be null.
};

/// Where models come from. Threads: any, but for List, which is called first and once.
class ModelSource {
 public:
  virtual ~ModelSource() = default;

  /// All models that the filter takes, in any order. What cannot be read is among them (a folder
  /// that may not be opened, a link that leads nowhere): Fetch then says why, so that it is not
  /// passed over in silence. Errors: kNotFound, kIo, of the place itself.
  virtual Result<std::vector<ModelEntry>> List(const ModelFilter& filter) = 0;
  /// The file of this path; nothing if there is none, or none that can be a model (a folder, a link
  /// out of the place). Errors: kIo.
  virtual Result<std::optional<ModelEntry>> Find(const std::string& path) = 0;
  /// The order in which models will be fetched, for places that fetch ahead. Called once, after
  /// List and before the first Fetch; the entries live until the source goes.
  virtual void Announce(std::span<const ModelEntry* const> order) { static_cast<void>(order); }
  /// Makes the model a local file. Blocks; `gone` is looked at now and then and ends it with
  /// kCancelled. Errors: kNotFound, kIo.
  virtual Result<LocalModel> Fetch(const ModelEntry& model, const std::function<bool()>& gone) = 0;
  /// The bytes of a small file (at most 1 MiB) such as a strata.toml; nothing if there is none.
  /// Errors: kIo, kOverBudget.
  virtual Result<std::optional<std::string>> ReadText(const std::string& path) = 0;
  /// How a path of this place is called in a message: "models/a.ply", "s3://bucket/a.ply".
  virtual std::string NameOf(const std::string& path) const = 0;
};

/// Where outputs go. An output is a path as a model's is, of a file, or of a folder of tiles.
///
/// A worker writes it whole at LocalPath; Publish then makes it the place's. Until Publish has
/// returned, the batch takes the model for undone.
///
/// Beside the outputs a place has a local folder of state, which holds the manifest, the lock and
/// the pictures. For a folder that is the folder itself. A bucket's is a local copy: OpenState
/// fetches what a former batch left there, SaveState stores it. Threads: any.
class OutputPlace {
 public:
  virtual ~OutputPlace() = default;

  /// The folder of state, made if it is missing. Called once, before all others but Exists.
  /// Errors: kIo.
  virtual Result<std::string> OpenState() = 0;
  /// Stores the state. Called after the lock is held: every now and then while the batch runs (from
  /// a thread of its own, with `last` false), and at its end. Errors: kIo.
  virtual Result<void> SaveState(bool last) {
    static_cast<void>(last);
    return {};
  }

  /// Where a worker is to write the output; the folder it lies in is made. Errors: kIo.
  virtual Result<std::string> LocalPath(const std::string& output) = 0;
  /// Makes what stands at LocalPath the place's, whole or not at all, in place of what had the
  /// name. Blocks, as Fetch does. Errors: kIo, kCancelled.
  virtual Result<void> Publish(const std::string& output, const std::function<bool()>& gone) = 0;
  /// Whether the output is there with `size` bytes (of a folder of tiles: of all its files).
  /// Errors: kIo.
  virtual Result<bool> IsThere(const std::string& output, std::uint64_t size) = 0;
  /// Removes an output, file or folder of tiles, and folders that are empty then. What is not there
  /// is no error. Errors: kIo.
  virtual Result<void> Remove(const std::string& output) = 0;
  /// Removes what a worker that was ended left unfinished of this output.
  virtual void Discard(const std::string& output) = 0;
  /// Removes what a batch that was killed left unfinished anywhere.
  virtual void DiscardAll() {}
  /// How an output is called in a message.
  virtual std::string NameOf(const std::string& output) const = 0;
};

}  // namespace strata::server
