// From what the stores keep to what the wire says.
#pragma once

#include "server/store/job.h"
#include "server/store/model_store.h"
#include "strata/v1/jobs.pb.h"
#include "strata/v1/models.pb.h"

namespace strata::server {

v1::Model MessageOf(const ModelInfo& model);
v1::Job MessageOf(const Job& job);
/// The store's words for a progress.
JobProgress ProgressOf(const v1::Progress& progress);
google::protobuf::Timestamp MessageOf(Timestamp time);
Timestamp TimeOf(const google::protobuf::Timestamp& time);
/// Both enumerations say the same; v1's begins with one more.
JobState StateOf(v1::Job::State state);

}  // namespace strata::server
