// Jobs as rows of strata.db.
#pragma once

#include <optional>
#include <string>

#include "core/result.h"
#include "server/store/database.h"
#include "server/store/job.h"

namespace strata::server {

/// The columns that ReadJob expects, for a SELECT.
extern const std::string kJobColumns;
Job ReadJob(const Row& row);

Result<std::optional<Job>> FindJob(Session& session, const std::string& id);
/// The job that `client` made with this key.
Result<std::optional<Job>> FindJobByKey(Session& session, const std::string& client,
                                        const std::string& idempotency_key);
/// Sets `number`. Keeps the model's content from being collected until the job is finished.
Result<void> InsertJob(Session& session, Job& job);
/// Writes all that changes of a job.
Result<void> UpdateJob(Session& session, const Job& job);

/// What tells two requests under one key apart: the model and the options as the client sent them.
std::string RequestHash(const JobRequest& request);

}  // namespace strata::server
