#include "server/batch/open_places.h"

#include <cstdlib>
#include <utility>

#include "server/batch/bucket_output.h"
#include "server/batch/bucket_source.h"
#include "server/batch/folder_places.h"
#include "server/remote/s3_config.h"
#include "server/remote/s3_name.h"

namespace strata::server {
namespace {

Result<std::unique_ptr<OutputPlace>> OpenOutput(const BatchCommand& command, const S3Config& config,
                                                const std::string& state) {
  if (!IsS3Url(command.output)) return OpenFolderOutput(command.output);
  return OpenBucketOutput(command.output, config, state);
}

Result<std::unique_ptr<ModelSource>> OpenSource(const BatchCommand& command, const S3Config& config,
                                                const std::string& state) {
  if (!IsS3Url(command.repository)) return OpenFolderSource(command.repository, command.output);
  const FetchAhead ahead{state + "/.strata/models" + ShareSuffix(command.share),
                         command.fetch_ahead_bytes, 4};
  return OpenBucketSource(command.repository, command.output, config, ahead);
}

}  // namespace

Result<Places> OpenPlaces(const BatchCommand& command) {
  S3Config config;
  std::string state = command.output;
  if (IsS3Url(command.repository) || IsS3Url(command.output)) {
    Result<S3Config> read = LoadS3Config(std::getenv, command.s3_insecure);
    if (!read) return Forward(read);
    config = std::move(*read);
  }
  // The secrets go no further than this process, also those that it does not need: workers, which
  // read what strangers wrote, do without.
  ForgetCredentialVariables();
  if (IsS3Url(command.output)) {
    Result<std::string> usual =
        command.state ? Result<std::string>(*command.state)
                      : DefaultStateFolder(command.output, ShareSuffix(command.share));
    if (!usual) return Forward(usual);
    state = std::move(*usual);
  }
  auto models = OpenSource(command, config, state);
  if (!models) return Forward(models);
  auto outputs = OpenOutput(command, config, state);
  if (!outputs) return Forward(outputs);
  return Places{*std::move(models), *std::move(outputs)};
}

}  // namespace strata::server
