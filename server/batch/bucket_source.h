// Models in buckets of S3-compatible stores.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "server/batch/places.h"
#include "server/remote/s3_config.h"

namespace strata::server {

/// Where fetched models wait for their turn.
struct FetchAhead {
  std::string folder;           ///< Of this batch alone; made if it is missing.
  std::uint64_t max_bytes = 0;  ///< Of models that wait or are being sampled.
  unsigned connections = 4;     ///< That fetch at a time.
};

/// The models below "s3://bucket/prefix", whose keys are taken as paths. Keys that are none
/// ("a/../b",
/// "/a", "a//b") are listed under a name that begins with '%' and cannot be fetched, so that they
/// stand in the manifest with their reason; nothing of a key becomes the name of a local file.
/// Hidden keys and those below `outputs`, should it lie inside, are passed over.
///
/// While models are sampled, the next ones are fetched: up to `max_bytes` together, and one that is
/// larger when its turn comes. Memory: the list of the keys.
/// Errors: kInvalidArgument (no address, or `outputs` is the same or holds it).
Result<std::unique_ptr<ModelSource>> OpenBucketSource(const std::string& url,
                                                      const std::string& outputs,
                                                      const S3Config& config,
                                                      const FetchAhead& ahead);

}  // namespace strata::server
