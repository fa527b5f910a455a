// The tables of strata.db and of PostgreSQL, and how an older database becomes a newer one.
#pragma once

#include <string>

#include "core/result.h"
#include "server/store/database.h"

namespace strata::server {

/// The version that this program writes (`PRAGMA user_version`).
int SchemaVersion();

/// Brings an SQLite database to SchemaVersion, each step in a transaction of its own.
/// Errors: kUnsupported for a newer version, kCorruptInput for another program's database, kIo.
Result<void> Migrate(Database& database);

/// The same for PostgreSQL, whose versions count for themselves (table `meta`).
int SharedSchemaVersion();
struct SharedStore {
  std::string id;  ///< 32 hex digits that tell the store, and its data folder, from others.
  bool has_folder = false;  ///< Whether a data folder bears the id already.
};
/// Makes the schema if it is missing and brings it to SharedSchemaVersion, all in one transaction,
/// which one process at a time can be in. Errors: as Migrate; IsDatabaseAway.
Result<SharedStore> MigrateShared(Database& database, const std::string& schema);
/// Whether this program may still use the database: kUnsupported once a newer one has migrated it.
Result<void> CheckShared(Database& database);

/// The condition, on a row of `blobs`, that nothing refers to it. Stands here beside the tables
/// that refer.
inline constexpr const char* kUnreferenced =
    "NOT EXISTS (SELECT 1 FROM models WHERE models.blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM results WHERE results.blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.result_blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.model_blob = blobs.hash)";

}  // namespace strata::server
