// A prefix of a bucket as the place where a store's content lies.
#pragma once

#include <memory>
#include <string>

#include "core/result.h"
#include "server/remote/s3_config.h"
#include "server/remote/s3_name.h"
#include "server/store/object_place.h"

namespace strata::server {

/// A request is tried again for a few seconds, then the bucket is away: from then on calls fail at
/// once, and one a second asks whether it answers. A journal in the folder `state`, which this
/// process has to itself, names puts in parts that are under way; what a former process left there
/// is aborted. Meanwhile ends all waiting. Errors: kIo (the journal).
Result<std::unique_ptr<ObjectPlace>> OpenBucketPlace(const S3Name& prefix, const S3Config& config,
                                                     const std::string& state);

}  // namespace strata::server
