// Models by name: uploaded ones, and those of a read-only repository.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/store/blob_store.h"
#include "server/store/clock.h"
#include "server/store/database.h"
#include "server/store/model_repository.h"

namespace strata::server {

struct ModelInfo {
  std::string name;
  std::string hash;  ///< SHA-256; in lists empty for a file of the repository not hashed yet.
  std::uint64_t size = 0;
  std::string format;  ///< "ply", "obj", "stl", "off", told from the content; "" if not known.
  Timestamp created;   ///< Of a file of the repository: when it was last changed.
  Timestamp modified;
  bool read_only = false;  ///< A file of the repository.
};

/// What must hold for Put and Delete to do anything.
struct ModelCondition {
  enum class Kind { kNone, kAbsent, kMatches };
  Kind kind = Kind::kNone;
  std::string hash;  ///< For kMatches: the model's present SHA-256.
};

struct PutModel {
  ModelInfo model;
  bool created = false;  ///< The name was free.
};

struct ModelQuery {
  std::string prefix;      ///< Of the name.
  std::size_t size = 100;  ///< 1 to 1000 models a page.
  std::string page_token;  ///< The last page's `next`; "" for the first page.
};

struct ModelPage {
  std::vector<ModelInfo> models;  ///< By the bytes of their names.
  std::string next;               ///< "" on the last page.
};

/// A model open for reading.
struct OpenModel {
  ModelInfo info;
  Fd fd;        ///< Of the whole content, read-only; a child process may inherit it. See ModelUse.
  BlobPin pin;  ///< Empty for a file of the repository.
  std::shared_ptr<const void> lease;     ///< As BlobReader's.
  std::shared_ptr<ObjectReader> object;  ///< As BlobReader's.

  /// Fills `out` from byte `offset`; not of what was opened for ModelUse::kName. Errors: kIo.
  Result<void> ReadAt(std::uint64_t offset, std::span<char> out) const {
    return object ? object->ReadAt(offset, out) : ReadFileAt(fd.get(), offset, out, info.name);
  }
};

/// What a model is opened for, which says how much of it must be at hand.
enum class ModelUse : std::uint8_t {
  kFile,   ///< `fd`, for another process; from a bucket it is fetched whole.
  kBytes,  ///< ReadAt.
  kName,   ///< What its content is, which stays while `pin` lives; nothing is opened.
};

/// The models of a service. A model that was put shadows a file of the repository that comes later
/// under its name. Threads: any.
class ModelStore {
 public:
  /// `repository` may be null. Everything outlives the store.
  ModelStore(BlobStore& blobs, Database& database, const ModelRepository* repository,
             const Clock& clock)
      : blobs_(blobs), database_(database), repository_(repository), clock_(clock) {}

  /// Makes `blob` the content of `name`. What had the name before is collected.
  /// Errors: kInvalidArgument (name), kConflict (the condition does not hold; the name is a file of
  /// the repository), kIo.
  Result<PutModel> Put(const std::string& name, const BlobPin& blob,
                       const ModelCondition& condition = {});

  /// Whether `name` is a file of the repository: what tells this kConflict of Put and Delete from
  /// that of a condition. Errors: kInvalidArgument, kIo.
  Result<bool> IsReadOnly(const std::string& name) const;
  /// Whether Put could take `name`. Errors: kInvalidArgument, kConflict, kIo.
  Result<void> CheckWritable(const std::string& name) const;

  /// A file of the repository is hashed by its first Get or Open, which takes as long as reading
  /// it. Errors: kInvalidArgument (name), kNotFound, kConflict (the file changed while it was
  /// read), kIo.
  Result<ModelInfo> Get(const std::string& name);
  Result<OpenModel> Open(const std::string& name, ModelUse use = ModelUse::kFile);
  /// The content with this hash, also when `name` has another now or is gone but a job still refers
  /// to the content. Errors: as Open; kNotFound when the content is gone.
  Result<OpenModel> OpenVersion(const std::string& name, const std::string& hash);

  /// A page holds every model that was there throughout; what comes or goes meanwhile may be in it
  /// or not, and never moves another one out of a page. Errors: kInvalidArgument (size, token),
  /// kIo.
  Result<ModelPage> List(const ModelQuery& query);

  /// Errors: kInvalidArgument (name), kNotFound, kConflict (condition; read-only), kIo.
  Result<void> Delete(const std::string& name, const ModelCondition& condition = {});

 private:
  Result<std::optional<ModelInfo>> Find(Session& session, const std::string& name) const;
  Result<std::optional<ModelInfo>> FindNow(const std::string& name) const;
  Result<OpenModel> OpenContent(ModelInfo info, ModelUse use);
  Result<OpenModel> OpenFile(const std::string& name);
  Result<std::string> HashOf(const std::string& name, const RepositoryFile& file);
  std::optional<std::string> KnownHash(const std::string& name, const std::string& fingerprint);
  Result<std::vector<ModelInfo>> ListStored(const ModelQuery& query, const std::string& after);
  Result<std::string> AddFiles(const ModelQuery& query, const std::string& after,
                               std::vector<ModelInfo>& models);
  std::string FormatOf(int fd, const std::string& name) const;

  BlobStore& blobs_;
  Database& database_;
  const ModelRepository* repository_;
  const Clock& clock_;
};

}  // namespace strata::server
