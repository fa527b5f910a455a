#include "server/store/schema.h"

#include <array>
#include <string>

#include "server/store/file.h"

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

// Attempts, and what only a shared store uses: whose file a row names, and when it was last used.
constexpr const char* kVersion2 = R"(
ALTER TABLE blobs ADD COLUMN file TEXT NOT NULL DEFAULT '';
ALTER TABLE blobs ADD COLUMN touched INTEGER NOT NULL DEFAULT 0;
ALTER TABLE uploads ADD COLUMN file TEXT NOT NULL DEFAULT '';
ALTER TABLE uploads ADD COLUMN holder TEXT NOT NULL DEFAULT '';
CREATE TABLE attempts (
  job INTEGER NOT NULL REFERENCES jobs(number) ON DELETE CASCADE, attempt INTEGER NOT NULL,
  owner TEXT NOT NULL, started INTEGER NOT NULL, ended INTEGER, why TEXT NOT NULL DEFAULT '',
  PRIMARY KEY (job, attempt)
) STRICT, WITHOUT ROWID;
)";

// What tells this store's bucket from others', and what is to be deleted from it.
constexpr const char* kVersion3 = R"(
CREATE TABLE store (id TEXT NOT NULL, bucket INTEGER NOT NULL) STRICT;
INSERT INTO store VALUES (lower(hex(randomblob(16))), 0);
CREATE TABLE blob_garbage (name TEXT PRIMARY KEY) STRICT, WITHOUT ROWID;
)";

// Step i leads from version i to i + 1. A step that has been released is never changed.
constexpr std::array kSteps = {kVersion1, kVersion2, kVersion3};

// --- PostgreSQL ----------------------------------------------------------------------------------

// The same tables, as they are in SQLite's version 2, and what several processes need: `processes`
// that live, `flights` (results that one of them computes), and triggers that tell of changes.
// Names sort by their bytes.
constexpr const char* kPostgres1 = R"(
CREATE TABLE processes (
  id TEXT PRIMARY KEY, name TEXT NOT NULL, started BIGINT NOT NULL, lease_until BIGINT NOT NULL
);
CREATE TABLE blobs (
  hash TEXT PRIMARY KEY, size BIGINT NOT NULL, kind BIGINT NOT NULL,
  file TEXT NOT NULL, touched BIGINT NOT NULL
);
CREATE TABLE models (
  name TEXT COLLATE "C" PRIMARY KEY, blob TEXT NOT NULL REFERENCES blobs(hash),
  format TEXT NOT NULL, created BIGINT NOT NULL, modified BIGINT NOT NULL
);
CREATE INDEX models_by_blob ON models(blob);
CREATE TABLE repository_files (
  name TEXT COLLATE "C" PRIMARY KEY, fingerprint TEXT NOT NULL, hash TEXT NOT NULL
);
CREATE TABLE uploads (
  id TEXT PRIMARY KEY, model TEXT NOT NULL, metadata TEXT NOT NULL, length BIGINT,
  "offset" BIGINT NOT NULL, created BIGINT NOT NULL, expires BIGINT NOT NULL, hash TEXT,
  file TEXT NOT NULL, holder TEXT NOT NULL
);
CREATE INDEX uploads_by_expiry ON uploads(expires);
CREATE TABLE jobs (
  number BIGINT GENERATED ALWAYS AS IDENTITY PRIMARY KEY, id TEXT NOT NULL UNIQUE,
  state BIGINT NOT NULL, model TEXT NOT NULL, model_hash TEXT NOT NULL,
  model_blob TEXT REFERENCES blobs(hash), options TEXT NOT NULL, result_key TEXT NOT NULL,
  client TEXT NOT NULL, idempotency_key TEXT, request_hash TEXT NOT NULL,
  created BIGINT NOT NULL, started BIGINT, finished BIGINT,
  attempts BIGINT NOT NULL DEFAULT 0, owner TEXT, lease_until BIGINT,
  cancel_requested BIGINT NOT NULL DEFAULT 0,
  stage TEXT NOT NULL DEFAULT '', done BIGINT NOT NULL DEFAULT 0, total BIGINT NOT NULL DEFAULT 0,
  sequence BIGINT NOT NULL DEFAULT 1, error_code BIGINT, error_message TEXT,
  result_blob TEXT REFERENCES blobs(hash), result_size BIGINT, media_type TEXT, summary TEXT
);
CREATE INDEX jobs_queued ON jobs(number) WHERE state = 0;
CREATE INDEX jobs_running ON jobs(lease_until) WHERE state = 1;
CREATE INDEX jobs_by_model ON jobs(model, number);
CREATE INDEX jobs_by_finish ON jobs(finished) WHERE finished IS NOT NULL;
CREATE UNIQUE INDEX jobs_by_key ON jobs(client, idempotency_key) WHERE idempotency_key IS NOT NULL;
CREATE INDEX jobs_by_result ON jobs(result_blob) WHERE result_blob IS NOT NULL;
CREATE INDEX jobs_by_model_blob ON jobs(model_blob) WHERE model_blob IS NOT NULL;
CREATE TABLE attempts (
  job BIGINT NOT NULL REFERENCES jobs(number) ON DELETE CASCADE, attempt BIGINT NOT NULL,
  owner TEXT NOT NULL, started BIGINT NOT NULL, ended BIGINT, why TEXT NOT NULL DEFAULT '',
  PRIMARY KEY (job, attempt)
);
CREATE TABLE results (
  key TEXT PRIMARY KEY, blob TEXT NOT NULL REFERENCES blobs(hash), media_type TEXT NOT NULL,
  summary TEXT NOT NULL, created BIGINT NOT NULL, last_used BIGINT NOT NULL
);
CREATE INDEX results_by_blob ON results(blob);
CREATE INDEX results_by_use ON results(last_used);
CREATE TABLE flights (
  key TEXT PRIMARY KEY, process TEXT NOT NULL REFERENCES processes(id) ON DELETE CASCADE
);

CREATE FUNCTION tell_of_job() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  PERFORM pg_notify(TG_TABLE_SCHEMA || '_jobs', NEW.id || ' ' || NEW.sequence);
  IF NEW.state = 0 AND (TG_OP = 'INSERT' OR OLD.state <> 0) THEN
    PERFORM pg_notify(TG_TABLE_SCHEMA || '_queue', '');
  END IF;
  RETURN NULL;
END $$;
CREATE TRIGGER tell AFTER INSERT OR UPDATE ON jobs FOR EACH ROW EXECUTE FUNCTION tell_of_job();
CREATE FUNCTION tell_of_flight() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
  PERFORM pg_notify(TG_TABLE_SCHEMA || '_flights', OLD.key);
  RETURN NULL;
END $$;
CREATE TRIGGER tell AFTER DELETE ON flights FOR EACH ROW EXECUTE FUNCTION tell_of_flight();
)";

// Blobs in a bucket: whether they are, what is to be deleted from it, and the pieces that
// unfinished uploads have there.
constexpr const char* kPostgres2 = R"(
ALTER TABLE meta ADD COLUMN bucket BIGINT NOT NULL DEFAULT 0;
CREATE TABLE blob_garbage (name TEXT PRIMARY KEY);
CREATE TABLE upload_pieces (
  upload TEXT NOT NULL REFERENCES uploads(id), "offset" BIGINT NOT NULL, size BIGINT NOT NULL,
  name TEXT NOT NULL, PRIMARY KEY (upload, "offset")
);
)";

// Batches, which each process ran for itself before.
constexpr const char* kPostgres3 = R"(
CREATE TABLE batches (
  id TEXT COLLATE "C" PRIMARY KEY, created BIGINT NOT NULL, ended BIGINT, state BIGINT NOT NULL,
  text TEXT NOT NULL, holder TEXT NOT NULL DEFAULT '', attempts BIGINT NOT NULL DEFAULT 0,
  cancel BIGINT NOT NULL DEFAULT 0, revision BIGINT NOT NULL DEFAULT 1
);
CREATE INDEX batches_by_creation ON batches(created, id);
CREATE INDEX batches_open ON batches(created, id) WHERE state < 3;
CREATE INDEX batches_by_end ON batches(ended) WHERE ended IS NOT NULL;
)";

constexpr std::array kPostgresSteps = {kPostgres1, kPostgres2, kPostgres3};

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

tl::unexpected<Error> FailNewer(const std::string& what, std::int64_t version, int known) {
  return Fail(ErrorCode::kUnsupported, what + ": version " + std::to_string(version) +
                                           " found, this program knows up to " +
                                           std::to_string(known));
}

}  // namespace

int SchemaVersion() { return static_cast<int>(kSteps.size()); }
int SharedSchemaVersion() { return static_cast<int>(kPostgresSteps.size()); }

Result<SharedStore> MigrateShared(Database& database, const std::string& schema) {
  SharedStore found;
  // One writer at a time: of two processes that start at once, the second finds it done.
  auto session = database.Write();
  if (!session) return Forward(session);
  bool there = false;
  auto looked = session->Query(
      "SELECT 1 FROM pg_catalog.pg_namespace WHERE nspname = ?", [&](const Row&) { there = true; },
      schema);
  if (!looked) return Forward(looked);
  if (!there) {
    // RandomId is the store's name, which its data folder bears too.
    auto made = session->RunScript("CREATE SCHEMA " + schema +
                                   "; CREATE TABLE meta (version BIGINT NOT NULL, store TEXT NOT "
                                   "NULL, folder BIGINT NOT NULL);"
                                   "INSERT INTO meta VALUES (0, '" +
                                   RandomId() + "', 0)");
    if (!made) return Forward(made);
  }
  std::int64_t version = -1;
  auto asked = session->Query("SELECT version, store, folder FROM meta", [&](const Row& row) {
    version = row.Int(0);
    found.id = row.Text(1);
    found.has_folder = row.Int(2) != 0;
  });
  if (!asked || version < 0) {
    return Fail(ErrorCode::kCorruptInput,
                "database: its schema " + schema + " is another program's, or damaged");
  }
  if (version > SharedSchemaVersion()) return FailNewer("database", version, SharedSchemaVersion());
  for (; version < SharedSchemaVersion(); ++version) {
    auto done = session->RunScript(kPostgresSteps[static_cast<std::size_t>(version)] +
                                   ("UPDATE meta SET version = " + std::to_string(version + 1)));
    if (!done) return Forward(done);
  }
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return found;
}

Result<void> CheckShared(Database& database) {
  std::int64_t version = 0;
  auto asked = database.Read().Query("SELECT version FROM meta",
                                     [&](const Row& row) { version = row.Int(0); });
  if (!asked) return Forward(asked);
  if (version > SharedSchemaVersion()) return FailNewer("database", version, SharedSchemaVersion());
  return {};
}

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
    return FailNewer("strata.db", version, SchemaVersion());
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
