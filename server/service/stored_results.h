// How a cached result is named and opened.
#pragma once

#include <string>

#include "server/service/service.h"
#include "server/store/blob_store.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// The key of the result of canonical options for a mesh of this hash, by this version.
std::string ResultKeyOf(const v1::SampleOptions& canonical, const std::string& model_hash);

/// A blob as what is sent; its hash is the strong entity tag.
Content ContentOf(BlobReader blob, const std::string& media_type);

}  // namespace strata::server
