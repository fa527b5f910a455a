#include "server/service/stored_messages.h"

#include <google/protobuf/util/time_util.h>

#include "server/service/canonical_options.h"
#include "server/service/problem.h"

namespace strata::server {

google::protobuf::Timestamp MessageOf(Timestamp time) {
  return google::protobuf::util::TimeUtil::MillisecondsToTimestamp(ToMillis(time));
}

Timestamp TimeOf(const google::protobuf::Timestamp& time) {
  return FromMillis(google::protobuf::util::TimeUtil::TimestampToMilliseconds(time));
}

JobState StateOf(v1::Job::State state) {
  return static_cast<JobState>(static_cast<int>(state) - 1);
}

v1::Model MessageOf(const ModelInfo& model) {
  v1::Model message;
  message.set_name(model.name);
  message.set_sha256(model.hash);
  message.set_size_bytes(model.size);
  message.set_format(model.format);
  *message.mutable_created() = MessageOf(model.created);
  message.set_read_only(model.read_only);
  return message;
}

v1::Job MessageOf(const Job& job) {
  v1::Job message;
  message.set_id(job.id);
  message.set_state(static_cast<v1::Job::State>(static_cast<int>(job.state) + 1));
  message.set_model(job.request.model);
  message.set_model_sha256(job.request.model_hash);
  // What this service wrote is what it reads: a failure would show as an empty field.
  static_cast<void>(FromJson(job.request.options, *message.mutable_options()));
  *message.mutable_created() = MessageOf(job.created);
  if (job.started) *message.mutable_started() = MessageOf(*job.started);
  if (job.finished) *message.mutable_ended() = MessageOf(*job.finished);
  message.set_attempts(static_cast<std::uint32_t>(job.attempts));
  v1::Progress::Stage stage = v1::Progress::unspecified;
  if (v1::Progress::Stage_Parse(job.progress.stage, &stage)) {
    message.mutable_progress()->set_stage(stage);
    message.mutable_progress()->set_done(job.progress.done);
    message.mutable_progress()->set_total(job.progress.total);
  }
  if (job.result) {
    static_cast<void>(FromJson(job.result->summary, *message.mutable_summary()));
    message.mutable_summary()->set_etag('"' + job.result->hash + '"');
  }
  for (const JobAttempt& attempt : job.history) {
    v1::Attempt& told = *message.add_history();
    told.set_number(static_cast<std::uint32_t>(attempt.number));
    told.set_owner(attempt.owner);
    *told.mutable_started() = MessageOf(attempt.started);
    if (attempt.ended) *told.mutable_ended() = MessageOf(*attempt.ended);
    told.set_why(attempt.why);
  }
  if (job.error) *message.mutable_error() = ToMessage(ProblemOf(*job.error), "");
  return message;
}

JobProgress ProgressOf(const v1::Progress& progress) {
  return {v1::Progress::Stage_Name(progress.stage()), progress.done(), progress.total()};
}

}  // namespace strata::server
