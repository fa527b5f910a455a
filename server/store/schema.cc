#include "server/store/schema.h"

#include <array>
#include <string>

namespace strata::server {
namespace {

// "STRA": tells Strata's databases from others'.
constexpr std::int64_t kApplicationId = 0x53545241;

// Times are milliseconds since 1970. Every column that names a blob REFERENCES it, so that SQLite
// itself refuses to forget a blob in use; kUnreferenced lists the same columns.
constexpr const char* kVersion1 = R"(
CREATE TABLE blobs (
  hash TEXT PRIMARY KEY, size INTEGER NOT NULL, kind INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE models (
  name TEXT PRIMARY KEY, blob TEXT NOT NULL REFERENCES blobs(hash), format TEXT NOT NULL,
  created INTEGER NOT NULL, modified INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX models_by_blob ON models(blob);

CREATE TABLE repository_files (
  name TEXT PRIMARY KEY, fingerprint TEXT NOT NULL, hash TEXT NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE uploads (
  id TEXT PRIMARY KEY, model TEXT NOT NULL, metadata TEXT NOT NULL,
  length INTEGER, offset INTEGER NOT NULL, created INTEGER NOT NULL, expires INTEGER NOT NULL,
  hash TEXT
) STRICT, WITHOUT ROWID;
CREATE INDEX uploads_by_expiry ON uploads(expires);

CREATE TABLE jobs (
  number INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, state INTEGER NOT NULL,
  model TEXT NOT NULL, model_hash TEXT NOT NULL, model_blob TEXT REFERENCES blobs(hash),
  options TEXT NOT NULL, result_key TEXT NOT NULL,
  client TEXT NOT NULL, idempotency_key TEXT, request_hash TEXT NOT NULL,
  created INTEGER NOT NULL, started INTEGER, finished INTEGER,
  attempts INTEGER NOT NULL DEFAULT 0, owner TEXT, lease_until INTEGER,
  cancel_requested INTEGER NOT NULL DEFAULT 0,
  stage TEXT NOT NULL DEFAULT '', done INTEGER NOT NULL DEFAULT 0, total INTEGER NOT NULL DEFAULT 0,
  sequence INTEGER NOT NULL DEFAULT 1,
  error_code INTEGER, error_message TEXT,
  result_blob TEXT REFERENCES blobs(hash), result_size INTEGER, media_type TEXT, summary TEXT
) STRICT;
CREATE INDEX jobs_by_state ON jobs(state, number);
CREATE INDEX jobs_by_model ON jobs(model, number);
CREATE INDEX jobs_by_finish ON jobs(finished) WHERE finished IS NOT NULL;
CREATE UNIQUE INDEX jobs_by_key ON jobs(client, idempotency_key) WHERE idempotency_key IS NOT NULL;
CREATE INDEX jobs_by_result ON jobs(result_blob) WHERE result_blob IS NOT NULL;
CREATE INDEX jobs_by_model_blob ON jobs(model_blob) WHERE model_blob IS NOT NULL;

CREATE TABLE results (
  key TEXT PRIMARY KEY, blob TEXT NOT NULL REFERENCES blobs(hash), media_type TEXT NOT NULL,
  summary TEXT NOT NULL, created INTEGER NOT NULL, last_used INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX results_by_blob ON results(blob);
CREATE INDEX results_by_use ON results(last_used);
)";

// Step i leads from version i to i + 1. A step that has been released is never changed.
constexpr std::array kSteps = {kVersion1};

Result<std::int64_t> Pragma(Session& session, const std::string& name) {
  std::int64_t value = 0;
  auto asked = session.Query("PRAGMA " + name, [&](const Row& row) { value = row.Int(0); });
  if (!asked) return Forward(asked);
  return value;
}

Result<void> CheckOwner(Session& session) {
  const auto id = Pragma(session, "application_id");
  if (!id) return Forward(id);
  bool empty = true;
  auto looked =
      session.Query("SELECT 1 FROM sqlite_schema LIMIT 1", [&](const Row&) { empty = false; });
  if (!looked) return Forward(looked);
  if (*id == kApplicationId || (*id == 0 && empty)) return {};
  return Fail(ErrorCode::kCorruptInput, "strata.db: application id " + std::to_string(*id) +
                                            " found: another program's database, expected " +
                                            std::to_string(kApplicationId));
}

}  // namespace

int SchemaVersion() { return static_cast<int>(kSteps.size()); }

Result<void> Migrate(Database& database) {
  std::int64_t version = 0;
  {
    Session session = database.Read();
    if (auto ours = CheckOwner(session); !ours) return ours;
    const auto found = Pragma(session, "user_version");
    if (!found) return Forward(found);
    version = *found;
  }
  if (version < 0 || version > SchemaVersion()) {
    return Fail(ErrorCode::kUnsupported, "strata.db: version " + std::to_string(version) +
                                             " found, this program knows up to " +
                                             std::to_string(SchemaVersion()));
  }
  for (; version < SchemaVersion(); ++version) {
    auto session = database.Write();
    if (!session) return Forward(session);
    const std::string marks = "PRAGMA application_id = " + std::to_string(kApplicationId) +
                              "; PRAGMA user_version = " + std::to_string(version + 1);
    auto done = session->RunScript(kSteps[static_cast<std::size_t>(version)] + marks);
    if (!done) return done;
    if (auto committed = session->Commit(); !committed) return committed;
  }
  return {};
}

}  // namespace strata::server
