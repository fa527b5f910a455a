// Where outputs are made before they have their names: temporary names beside the final one, locks,
// and what dead processes left. Shared by AtomicFile and AtomicFolder.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace strata::io {

/// What a temporary name stands for.
enum class TemporaryKind {
  kFile,    ///< `.<name>.strata-<16 hex digits>.part`, a regular file.
  kFolder,  ///< `.<name>.strata-<16 hex digits>.folder`, a folder, or what a folder replaced.
};

/// A new name for `base`, cut so that the system takes it.
std::string NewTemporaryName(const std::string& base, TemporaryKind kind);

/// Between the two, RemoveUnfinishedOutputs removes `name` in the open folder `parent`.
void RegisterTemporary(int parent, const std::string& name);
void UnregisterTemporary(int parent, const std::string& name);

/// Whether `name` in `parent` is the open file or folder `fd`, and not a link to it.
bool NameRefersTo(int parent, const char* name, int fd);

/// What a name stands for that is ours; nothing for others.
using KindOfName = std::optional<TemporaryKind> (*)(std::string_view name);
std::optional<TemporaryKind> KindOfTemporary(std::string_view name);

/// Removes the files and folders in `folder` that have names of ours and that no living process has
/// locked.
void RemoveLeftovers(int folder, KindOfName kind = KindOfTemporary);

/// Removes `name` in `parent`, and if it is a folder all that it holds. Follows no link.
void RemoveTree(int parent, const char* name);

/// Gives what stands under `temporary` in `parent` the name `final_name`, in place of what has it:
/// by exchanging the two names where one is a folder and the system can, else by moving the old one
/// to a temporary name first.
struct Replacement {
  int error = 0;         ///< 0 or an errno; then nothing has changed.
  std::string replaced;  ///< Where the old one stands now, to be removed; empty: nowhere.
};
Replacement GiveFinalName(int parent, const std::string& temporary, const std::string& final_name);
/// The same for what stands under `temporary` in the folder `from`. A name to be removed that is
/// `temporary` stands in `from`, any other in `parent`.
Replacement GiveFinalName(int from, const std::string& temporary, int parent,
                          const std::string& final_name);

/// Why a folder of results that hold a file named `mark` may not have the name `name` in `parent`,
/// or nothing: it may replace a file, an empty folder and a folder with such a file.
std::string WhyNotReplaceable(int parent, const std::string& name, const std::string& mark);

/// Syncs the folder `name` in `parent` to disk. Returns 0 or an errno.
int SyncFolder(int parent, const char* name);

/// The names in an open folder, in no order: all at once, because a loop that removes while it
/// reads may skip some.
std::vector<std::string> NamesIn(int folder);

/// Whether `name` in `parent` is a folder that holds a file named `mark`.
bool IsMarkedFolder(int parent, const std::string& name, const std::string& mark);
/// Whether the folder `name` in `parent` can be read and holds nothing.
bool IsEmptyFolder(int parent, const char* name);

/// The system's words for an errno.
std::string SystemReason(int error);

/// The folder part of a path; "." if there is none.
std::string FolderOf(const std::string& path);

/// Follows symbolic links of the last component, dangling ones too. Empty on a loop.
std::string ResolveLinks(std::string path);

/// The descriptor behind a name of one of this process's open files: "-", /dev/stdout, /dev/fd/N.
/// These are duplicated, because opening them by name would start a regular file behind them again
/// at its first byte.
std::optional<int> OwnDescriptor(std::string_view path);

/// Whether what is written to `path` goes straight through, because it cannot be replaced: standard
/// output and other open files, devices, FIFOs.
bool IsWrittenThrough(const std::string& path);

/// Writes all of `bytes`, adding to `written` as they go. Returns 0 or an errno: a closed pipe and
/// the file size limit are errors here, not signals.
int WriteAll(int fd, std::string_view bytes, std::uint64_t& written);

}  // namespace strata::io
