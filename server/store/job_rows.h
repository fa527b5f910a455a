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

/// With its history. `lock` follows the statement: "", or Database::for_update.
Result<std::optional<Job>> FindJob(Session& session, const std::string& id,
                                   const std::string& lock = {});
/// The oldest queued job; `lock` as above.
Result<std::optional<Job>> FindQueued(Session& session, const std::string& lock);
/// The job that `client` made with this key.
Result<std::optional<Job>> FindJobByKey(Session& session, const std::string& client,
                                        const std::string& idempotency_key);
/// Sets `number`. Keeps the model's content from being collected until the job is finished.
Result<void> InsertJob(Session& session, Job& job);
/// Writes all that changes of a job, its latest attempt included.
Result<void> UpdateJob(Session& session, const Job& job);

/// A running attempt's progress and lease, in one statement. The job as it is then, with its
/// history; nothing if the claim is not valid any more: the job is not in this attempt, or its
/// lease ran out before `now`.
struct JobBeat {
  std::string id;
  std::int64_t attempt;
  JobProgress progress;
  Timestamp now, lease_until;
};
Result<std::optional<Job>> BeatJob(Session& session, const JobBeat& beat);

/// kNotFound.
tl::unexpected<Error> FailNoSuchJob();

/// What tells two requests under one key apart: the model and the options as the client sent them.
std::string RequestHash(const JobRequest& request);

}  // namespace strata::server
