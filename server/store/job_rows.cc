#include "server/store/job_rows.h"

#include <utf8cpp/utf8.h>

#include <algorithm>

#include "io/sha256.h"

namespace strata::server {
namespace {

std::optional<Timestamp> MaybeTime(const Row& row, int column) {
  const auto millis = row.MaybeInt(column);
  return millis ? std::optional(FromMillis(*millis)) : std::nullopt;
}

std::optional<std::int64_t> Millis(const std::optional<Timestamp>& time) {
  return time ? std::optional(ToMillis(*time)) : std::nullopt;
}

std::optional<std::string_view> Filled(const std::string& text) {
  return text.empty() ? std::nullopt : std::optional<std::string_view>(text);
}

// The outcome: columns 20 on.
void ReadOutcome(const Row& row, Job& job) {
  if (const auto code = row.MaybeInt(20)) {
    job.error = Error{static_cast<ErrorCode>(*code), row.Text(21)};
  }
  if (!row.IsNull(22)) {
    job.result = JobResult{row.Text(22), static_cast<std::uint64_t>(row.Int(23)), row.Text(24),
                           row.Text(25)};
  }
}

Result<void> ReadHistory(Session& session, Job& job) {
  if (job.attempts == 0) return {};
  auto asked = session.Query(
      "SELECT attempt, owner, started, ended, why FROM attempts WHERE job = ? ORDER BY attempt",
      [&](const Row& row) {
        job.history.push_back(
            {row.Int(0), row.Text(1), FromMillis(row.Int(2)), MaybeTime(row, 3), row.Text(4)});
      },
      job.number);
  if (!asked) return Forward(asked);
  return {};
}

Result<std::optional<Job>> FindWhere(Session& session, const std::string& condition,
                                     const auto&... values) {
  std::optional<Job> job;
  auto asked = session.Query(
      "SELECT " + kJobColumns + " FROM jobs WHERE " + condition,
      [&](const Row& row) { job = ReadJob(row); }, values...);
  if (!asked) return Forward(asked);
  if (job) {
    if (auto read = ReadHistory(session, *job); !read) return Forward(read);
  }
  return job;
}

// What the message of an error quotes may be any bytes; PostgreSQL takes UTF-8 alone.
std::string ValidText(const std::string& text) {
  std::string valid = utf8::replace_invalid(text);
  std::ranges::replace(valid, '\0', ' ');
  return valid;
}

Result<void> UpdateAttempt(Session& session, const Job& job) {
  if (job.history.empty()) return {};
  const JobAttempt& latest = job.history.back();
  auto written = session.Run(
      "INSERT INTO attempts (job, attempt, owner, started, ended, why) VALUES (?, ?, ?, ?, ?, ?)"
      " ON CONFLICT (job, attempt) DO UPDATE SET ended = excluded.ended, why = excluded.why",
      job.number, latest.number, latest.owner, ToMillis(latest.started), Millis(latest.ended),
      ValidText(latest.why));
  if (!written) return Forward(written);
  return {};
}

}  // namespace

const std::string kJobColumns =
    "number, id, model, model_hash, options, result_key, client, idempotency_key,"         // 0 to 7
    " state, created, started, finished, attempts, owner, lease_until, cancel_requested,"  // to 15
    " stage, done, total, sequence,"                                                       // to 19
    " error_code, error_message, result_blob, result_size, media_type, summary";           // to 25

Job ReadJob(const Row& row) {
  Job job;
  job.number = row.Int(0);
  job.id = row.Text(1);
  job.request = {row.Text(2), row.Text(3), row.Text(4), row.Text(5), row.Text(6), row.Text(7)};
  job.state = static_cast<JobState>(row.Int(8));
  job.created = FromMillis(row.Int(9));
  job.started = MaybeTime(row, 10);
  job.finished = MaybeTime(row, 11);
  job.attempts = row.Int(12);
  job.owner = row.Text(13);
  job.lease_until = MaybeTime(row, 14);
  job.cancel_requested = row.Int(15) != 0;
  job.progress = {row.Text(16), static_cast<std::uint64_t>(row.Int(17)),
                  static_cast<std::uint64_t>(row.Int(18))};
  job.sequence = static_cast<std::uint64_t>(row.Int(19));
  ReadOutcome(row, job);
  return job;
}

Result<std::optional<Job>> FindJob(Session& session, const std::string& id,
                                   const std::string& lock) {
  return FindWhere(session, "id = ?" + lock, id);
}

Result<std::optional<Job>> FindQueued(Session& session, const std::string& lock) {
  return FindWhere(session, "state = 0 ORDER BY number LIMIT 1" + lock);
}

Result<std::optional<Job>> BeatJob(Session& session, const JobBeat& beat) {
  static const std::string kUpdate =
      "UPDATE jobs SET stage = ?, done = ?, total = ?, lease_until = ?, sequence = sequence + 1"
      " WHERE id = ? AND state = 1 AND attempts = ? AND lease_until > ? RETURNING " +
      kJobColumns;
  std::optional<Job> job;
  auto updated = session.Query(
      kUpdate, [&](const Row& row) { job = ReadJob(row); }, beat.progress.stage, beat.progress.done,
      beat.progress.total, ToMillis(beat.lease_until), beat.id, beat.attempt, ToMillis(beat.now));
  if (!updated) return Forward(updated);
  if (job) {
    if (auto read = ReadHistory(session, *job); !read) return Forward(read);
  }
  return job;
}

Result<std::optional<Job>> FindJobByKey(Session& session, const std::string& client,
                                        const std::string& idempotency_key) {
  return FindWhere(session, "client = ? AND idempotency_key = ?", client, idempotency_key);
}

Result<void> InsertJob(Session& session, Job& job) {
  const JobRequest& request = job.request;
  auto inserted = session.Query(
      "INSERT INTO jobs (id, state, model, model_hash, model_blob, options, result_key, client,"
      " idempotency_key, request_hash, created)"
      " VALUES (?1, ?2, ?3, ?4, (SELECT hash FROM blobs WHERE hash = ?4), ?5, ?6, ?7, ?8, ?9, ?10)"
      " RETURNING number",
      [&](const Row& row) { job.number = row.Int(0); }, job.id,
      static_cast<std::int64_t>(job.state), request.model, request.model_hash, request.options,
      request.result_key, request.client, Filled(request.idempotency_key), RequestHash(request),
      ToMillis(job.created));
  if (!inserted) return Forward(inserted);
  return {};
}

Result<void> UpdateJob(Session& session, const Job& job) {
  const bool finished = IsFinished(job.state);
  const JobResult result = job.result.value_or(JobResult{});
  std::optional<std::int64_t> error_code, result_size;
  if (job.error) error_code = static_cast<std::int64_t>(job.error->code);
  if (job.result) result_size = static_cast<std::int64_t>(result.size);
  auto updated = session.Run(
      "UPDATE jobs SET state = ?, started = ?, finished = ?, attempts = ?, owner = ?,"
      " lease_until = ?, cancel_requested = ?, stage = ?, done = ?, total = ?, sequence = ?,"
      " error_code = ?, error_message = ?, result_blob = ?, result_size = ?, media_type = ?,"
      " summary = ?, model_blob = CASE WHEN ? = 1 THEN NULL ELSE model_blob END WHERE number = ?",
      static_cast<std::int64_t>(job.state), Millis(job.started), Millis(job.finished), job.attempts,
      Filled(job.owner), Millis(job.lease_until), std::int64_t{job.cancel_requested},
      job.progress.stage, static_cast<std::int64_t>(job.progress.done),
      static_cast<std::int64_t>(job.progress.total), static_cast<std::int64_t>(job.sequence),
      error_code, job.error ? std::optional(ValidText(job.error->message)) : std::nullopt,
      Filled(result.hash), result_size, Filled(result.media_type), Filled(result.summary),
      std::int64_t{finished}, job.number);
  if (!updated) return Forward(updated);
  return UpdateAttempt(session, job);
}

tl::unexpected<Error> FailNoSuchJob() {
  return Fail(ErrorCode::kNotFound, "job: there is none of this name");
}

std::string RequestHash(const JobRequest& request) {
  const std::string& model = request.model.empty() ? request.model_hash : request.model;
  // Lengths first: no two requests give the same text.
  return io::Sha256Hex(std::to_string(model.size()) + ' ' + model + ' ' + request.options);
}

}  // namespace strata::server
