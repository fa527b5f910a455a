// Options in the one form that names a result.
#pragma once

#include <string>

#include "core/result.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// The same options with every default written out, names in order, and without those of how it
/// runs: two that are equal afterwards give the same bytes. Errors: as CommandOf.
Result<v1::SampleOptions> Canonical(const v1::SampleOptions& options);

/// A message as JSON on one line, field names as in the proto; and back. Errors: kInvalidArgument.
std::string JsonOf(const google::protobuf::Message& message);
Result<void> FromJson(const std::string& json, google::protobuf::Message& message);

}  // namespace strata::server
