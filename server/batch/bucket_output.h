// Outputs of a batch in a bucket of an S3-compatible store.
#pragma once

#include <memory>
#include <string>
#include <string_view>

#include "server/batch/places.h"
#include "server/remote/s3_config.h"

namespace strata::server {

/// Outputs below "s3://bucket/prefix". A worker writes an output to a local file, which Publish
/// puts into the bucket and removes. A file appears there whole or not at all. Of a folder of
/// tiles, the tileset.json of the former one goes first and that of the new one comes last: where
/// it stands, all it names is there.
///
/// `state_folder` is this batch's alone. It keeps the manifest, which SaveState puts into the
/// bucket as well (with the pictures and the report), and a list of the uploads that are under way.
/// OpenState takes from the bucket what another machine wrote there since, and aborts uploads that
/// a killed batch left: those in its list, and any below the prefix that are older than a day.
///
/// Memory: the list of the keys below the prefix.
/// Errors: kInvalidArgument (no address); of OpenState also kConflict (another process has the
/// folder).
Result<std::unique_ptr<OutputPlace>> OpenBucketOutput(const std::string& url,
                                                      const S3Config& config,
                                                      const std::string& state_folder);

/// Whether a name below OUT is that of a manifest, or of a picture, which go with the outputs.
bool IsBatchManifest(std::string_view name);
bool IsBatchPicture(std::string_view name);

/// Where the state of a batch into `url` is kept by default: a folder below $XDG_CACHE_HOME/strata
/// or
/// ~/.cache/strata, named for a hash of `url` and `share`. Errors: kInvalidArgument (neither is
/// set).
Result<std::string> DefaultStateFolder(const std::string& url, const std::string& share);

}  // namespace strata::server
