#include "server/store/model_store.h"

#include <algorithm>
#include <iterator>

#include "io/byte_source.h"
#include "io/detect_format.h"
#include "server/store/model_name.h"
#include "server/store/page_token.h"

namespace strata::server {
namespace {

constexpr char kTokenKind = 'm';

ModelInfo InfoOf(const Row& row) {
  ModelInfo info;
  info.name = row.Text(0);
  info.hash = row.Text(1);
  info.size = static_cast<std::uint64_t>(row.Int(2));
  info.format = row.Text(3);
  info.created = FromMillis(row.Int(4));
  info.modified = FromMillis(row.Int(5));
  return info;
}

ModelInfo InfoOf(const std::string& name, const RepositoryFile& file) {
  ModelInfo info;
  info.name = name;
  info.size = file.size;
  info.created = info.modified = file.modified;
  info.read_only = true;
  return info;
}

tl::unexpected<Error> FailMissing(const std::string& name) {
  return Fail(ErrorCode::kNotFound, "model " + name + ": there is no such model");
}

tl::unexpected<Error> FailReadOnly(const std::string& name) {
  return Fail(ErrorCode::kConflict,
              "model " + name + ": a file of the read-only repository has this name");
}

Result<void> Check(const std::string& name, const std::optional<ModelInfo>& present,
                   const ModelCondition& condition) {
  using Kind = ModelCondition::Kind;
  if (condition.kind == Kind::kAbsent && present) {
    return Fail(ErrorCode::kConflict, "model " + name + ": exists, expected none");
  }
  if (condition.kind == Kind::kMatches && (!present || present->hash != condition.hash)) {
    return Fail(ErrorCode::kConflict, "model " + name + ": " +
                                          (present ? "SHA-256 " + present->hash : "nothing") +
                                          " found, expected " + condition.hash);
  }
  return {};
}

}  // namespace

Result<std::optional<ModelInfo>> ModelStore::Find(Session& session, const std::string& name) const {
  std::optional<ModelInfo> info;
  auto asked = session.Query(
      "SELECT name, blob, size, format, created, modified FROM models JOIN blobs"
      " ON blobs.hash = models.blob WHERE name = ?",
      [&](const Row& row) { info = InfoOf(row); }, name);
  if (!asked) return Forward(asked);
  return info;
}

Result<std::optional<ModelInfo>> ModelStore::FindNow(const std::string& name) const {
  Session session = database_.Read();
  return Find(session, name);
}

Result<bool> ModelStore::IsReadOnly(const std::string& name) const {
  if (auto valid = CheckModelName(name); !valid) return Forward(valid);
  const auto stored = FindNow(name);
  if (!stored) return Forward(stored);
  return !*stored && repository_ != nullptr && repository_->OpenFile(name);
}

Result<void> ModelStore::CheckWritable(const std::string& name) const {
  const auto read_only = IsReadOnly(name);
  if (!read_only) return Forward(read_only);
  if (*read_only) return FailReadOnly(name);
  return {};
}

std::string ModelStore::FormatOf(int fd, const std::string& name) const {
  // Opened by descriptor: the name is the user's and may be taken by another file meanwhile.
  auto source = io::OpenByteSource("/proc/self/fd/" + std::to_string(fd));
  if (!source) return {};
  std::string head(io::kDetectBytes, 0);
  std::size_t filled = 0;
  while (filled < head.size()) {
    const auto n = (*source)->Read(std::span(head).subspan(filled));
    if (!n || *n == 0) break;
    filled += *n;
  }
  const auto format =
      io::DetectFormat({std::string_view(head).substr(0, filled), (*source)->size(), name});
  return format ? io::NameOf(*format) : "";
}

Result<PutModel> ModelStore::Put(const std::string& name, const BlobPin& blob,
                                 const ModelCondition& condition) {
  if (auto writable = CheckWritable(name); !writable) return Forward(writable);
  const auto content = blobs_.OpenBlobFile(blob.hash());
  if (!content) return Forward(content);
  PutModel put;
  const Timestamp now = clock_.Now();
  put.model = {name, blob.hash(), blob.size(), FormatOf(content->fd.get(), name), now, now, false};
  std::string replaced;
  {
    auto session = database_.Write();
    if (!session) return Forward(session);
    const auto present = Find(*session, name);
    if (!present) return Forward(present);
    if (auto holds = Check(name, *present, condition); !holds) return Forward(holds);
    put.created = !present->has_value();
    if (*present) {
      replaced = (*present)->hash;
      put.model.created = (*present)->created;
    }
    auto stored = session->Run(
        "INSERT INTO models (name, blob, format, created, modified) VALUES (?, ?, ?, ?, ?)"
        " ON CONFLICT (name) DO UPDATE SET blob = excluded.blob, format = excluded.format,"
        " modified = excluded.modified",
        name, blob.hash(), put.model.format, ToMillis(put.model.created), ToMillis(now));
    if (!stored) return Forward(stored);
    if (auto committed = session->Commit(); !committed) return Forward(committed);
  }
  if (!replaced.empty()) blobs_.Collect(replaced);
  return put;
}

Result<ModelInfo> ModelStore::Get(const std::string& name) {
  auto model = Open(name, ModelUse::kName);
  if (!model) return Forward(model);
  return model->info;
}

Result<OpenModel> ModelStore::OpenContent(ModelInfo info, ModelUse use) {
  OpenModel model;
  const std::string hash = info.hash;
  model.info = std::move(info);
  // In a folder, to open it is to see that it is there.
  if (use == ModelUse::kName && blobs_.bucket()) {
    auto pin = blobs_.Pin(hash);
    if (!pin) return Forward(pin);
    model.pin = std::move(*pin);
    return model;
  }
  auto content = use == ModelUse::kFile ? blobs_.OpenBlobFile(hash) : blobs_.OpenBlob(hash);
  if (!content) return Forward(content);
  model.fd = std::move(content->fd);
  model.pin = std::move(content->pin);
  model.lease = std::move(content->lease);
  model.object = std::move(content->object);
  return model;
}

Result<OpenModel> ModelStore::Open(const std::string& name, ModelUse use) {
  if (auto valid = CheckModelName(name); !valid) return Forward(valid);
  // The content may be replaced and collected between the two steps; then there is newer content.
  for (int attempt = 0; attempt < 100; ++attempt) {
    const auto stored = FindNow(name);
    if (!stored) return Forward(stored);
    if (!*stored) return OpenFile(name);
    auto model = OpenContent(**stored, use);
    if (model || model.error().code != ErrorCode::kNotFound) return model;
  }
  return Fail(ErrorCode::kConflict, "model " + name + ": replaced again and again while opened");
}

Result<OpenModel> ModelStore::OpenVersion(const std::string& name, const std::string& hash) {
  if (!IsHash(hash)) return Fail(ErrorCode::kInvalidArgument, "SHA-256: not 64 hex digits");
  ModelInfo info;
  info.name = name;
  info.hash = hash;
  auto content = OpenContent(info, ModelUse::kFile);
  if (content) {
    content->info.size = content->pin.size();
    return content;
  }
  if (content.error().code != ErrorCode::kNotFound) return Forward(content);
  auto model = Open(name);
  if (model && model->info.hash != hash) {
    return Fail(ErrorCode::kNotFound, "model " + name + ": SHA-256 " + model->info.hash +
                                          " found, the content " + hash + " is gone");
  }
  return model;
}

Result<OpenModel> ModelStore::OpenFile(const std::string& name) {
  if (repository_ == nullptr) return FailMissing(name);
  auto file = repository_->OpenFile(name);
  if (!file && file.error().code == ErrorCode::kNotFound) return FailMissing(name);
  if (!file) return Forward(file);
  ModelInfo info = InfoOf(name, *file);
  auto hash = HashOf(name, *file);
  if (!hash) return Forward(hash);
  info.hash = std::move(*hash);
  info.format = FormatOf(file->fd.get(), name);
  return OpenModel{std::move(info), std::move(file->fd), {}, {}, {}};
}

std::optional<std::string> ModelStore::KnownHash(const std::string& name,
                                                 const std::string& fingerprint) {
  std::optional<std::string> hash;
  const auto note = [&](const Row& row) { hash = row.Text(0); };
  // Without an answer the file is hashed again: slower, not wrong.
  (void)database_.Read().Query(
      "SELECT hash FROM repository_files WHERE name = ? AND fingerprint = ?", note, name,
      fingerprint);
  return hash;
}

Result<std::string> ModelStore::HashOf(const std::string& name, const RepositoryFile& file) {
  if (auto known = KnownHash(name, file.fingerprint)) return *known;
  auto hash = HashFile(file.fd.get(), file.size, "model " + name);
  if (!hash) return hash;
  const auto again = repository_->OpenFile(name);
  if (!again || again->fingerprint != file.fingerprint) {
    return Fail(ErrorCode::kConflict, "model " + name + ": the file changed while it was read");
  }
  if (!file.settled) return hash;
  auto session = database_.Write();
  if (session) {
    // The same: what cannot be noted is hashed again.
    auto noted = session->Run(
        "INSERT INTO repository_files (name, fingerprint, hash) VALUES (?, ?, ?)"
        " ON CONFLICT (name) DO UPDATE SET fingerprint = excluded.fingerprint, hash = "
        "excluded.hash",
        name, file.fingerprint, *hash);
    if (noted) (void)session->Commit();
  }
  return hash;
}

Result<std::vector<ModelInfo>> ModelStore::ListStored(const ModelQuery& query,
                                                      const std::string& after) {
  std::vector<ModelInfo> models;
  auto asked = database_.Read().Query(
      "SELECT name, blob, size, format, created, modified FROM models JOIN blobs"
      " ON blobs.hash = models.blob"
      " WHERE name > ?1 AND name >= ?2 AND substr(name, 1, length(?2)) = ?2"
      " ORDER BY name LIMIT ?3",
      [&](const Row& row) { models.push_back(InfoOf(row)); }, after, query.prefix,
      static_cast<std::int64_t>(query.size + 1));
  if (!asked) return Forward(asked);
  return models;
}

// Returns the name beyond which there may be files that were not looked at; "" if there are none.
Result<std::string> ModelStore::AddFiles(const ModelQuery& query, const std::string& after,
                                         std::vector<ModelInfo>& models) {
  const auto names = repository_->List(query.prefix, after, query.size + 1);
  if (!names) return Forward(names);
  std::vector<ModelInfo> files;
  for (const std::string& name : *names) {
    const auto file = repository_->OpenFile(name);
    if (!file) continue;  // It went away.
    ModelInfo info = InfoOf(name, *file);
    info.hash = KnownHash(name, file->fingerprint).value_or("");
    info.format = FormatOf(file->fd.get(), name);
    files.push_back(std::move(info));
  }
  // Of two equals set_union keeps the first range's: the stored model.
  std::vector<ModelInfo> all;
  std::ranges::set_union(models, files, std::back_inserter(all), {}, &ModelInfo::name,
                         &ModelInfo::name);
  models = std::move(all);
  return names->size() > query.size ? names->back() : std::string();
}

Result<ModelPage> ModelStore::List(const ModelQuery& query) {
  if (auto size = CheckPageSize(query.size); !size) return Forward(size);
  const auto after = ReadPageToken(kTokenKind, query.page_token);
  if (!after) return Forward(after);
  auto models = ListStored(query, *after);
  if (!models) return Forward(models);
  Result<std::string> seen_to = std::string();
  if (repository_ != nullptr) seen_to = AddFiles(query, *after, *models);
  if (!seen_to) return Forward(seen_to);
  ModelPage page;
  page.models = std::move(*models);
  if (page.models.size() > query.size) {
    page.models.resize(query.size);
    page.next = MakePageToken(kTokenKind, page.models.back().name);
  } else if (!seen_to->empty()) {
    // Some of the files went away between listing and opening: the page is short, not the last.
    std::erase_if(page.models, [&](const ModelInfo& info) { return info.name > *seen_to; });
    page.next = MakePageToken(kTokenKind, *seen_to);
  }
  return page;
}

Result<void> ModelStore::Delete(const std::string& name, const ModelCondition& condition) {
  if (auto valid = CheckModelName(name); !valid) return valid;
  std::string hash;
  {
    auto session = database_.Write();
    if (!session) return Forward(session);
    const auto present = Find(*session, name);
    if (!present) return Forward(present);
    if (auto holds = Check(name, *present, condition); *present && !holds) return holds;
    if (*present) hash = (*present)->hash;
    auto deleted = session->Run("DELETE FROM models WHERE name = ?", name);
    if (!deleted) return Forward(deleted);
    if (auto committed = session->Commit(); !committed) return committed;
  }
  if (!hash.empty()) {
    blobs_.Collect(hash);
    return {};
  }
  if (repository_ != nullptr && repository_->OpenFile(name)) return FailReadOnly(name);
  return FailMissing(name);
}

}  // namespace strata::server
