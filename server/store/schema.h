// The tables of strata.db, and how an older database becomes a newer one.
#pragma once

#include "core/result.h"
#include "server/store/database.h"

namespace strata::server {

/// The version that this program writes (`PRAGMA user_version`).
int SchemaVersion();

/// Brings a database to SchemaVersion, each step in a transaction of its own.
/// Errors: kUnsupported for a newer version, kCorruptInput for another program's database, kIo.
Result<void> Migrate(Database& database);

/// The condition, on a row of `blobs`, that nothing refers to it. Stands here beside the tables
/// that refer.
inline constexpr const char* kUnreferenced =
    "NOT EXISTS (SELECT 1 FROM models WHERE models.blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM results WHERE results.blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.result_blob = blobs.hash)"
    " AND NOT EXISTS (SELECT 1 FROM jobs WHERE jobs.model_blob = blobs.hash)";

}  // namespace strata::server
