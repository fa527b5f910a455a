// Where a store is and who asks: from the environment and the files that every S3 program reads.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "core/result.h"

namespace strata::server {

/// How to reach one S3-compatible store. Holds secrets: it is never logged or put into a message.
struct S3Config {
  std::string endpoint;  ///< "https://host[:port]"; empty: AWS's own of the bucket's region.
  std::string region = "us-east-1";
  bool virtual_hosts = true;  ///< The bucket is a part of the host's name, else of the path.
  bool allow_http = false;    ///< Plain http to other machines, too.
  std::string access_key, secret_key;
  std::string session_token;  ///< Empty: none.
  std::string ca_file;        ///< Certificates to trust; empty: the system's.
  int max_attempts = 6;       ///< Of one request, or of one object without any progress: 1 to 100.
  int stall_seconds = 30;  ///< A transfer that moves less than 1 KiB/s for so long is broken off.
};

/// Reads one variable of an environment; null or empty: it is not set.
using Environment = std::function<const char*(const char* name)>;

/// From AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and AWS_SESSION_TOKEN, else from the profile
/// (AWS_PROFILE, "default") of the credentials file (AWS_SHARED_CREDENTIALS_FILE,
/// ~/.aws/credentials), else of the config file (AWS_CONFIG_FILE, ~/.aws/config). The region from
/// AWS_REGION or AWS_DEFAULT_REGION, the endpoint from AWS_ENDPOINT_URL_S3 or AWS_ENDPOINT_URL,
/// else `region`, `endpoint_url` and `addressing_style` of the profile. Also AWS_CA_BUNDLE and
/// AWS_MAX_ATTEMPTS. An endpoint of one's own has the bucket in its path unless the
/// `addressing_style` is `virtual`.
///
/// Errors: kInvalidArgument (no credentials, a profile that wants a program or a service asked for
/// them, a malformed value; plain http to another machine without `allow_http`), kNotFound (an
/// unreadable file), kCorruptInput (a malformed one). No message holds a secret.
Result<S3Config> LoadS3Config(const Environment& environment, bool allow_http);

/// Takes the secrets out of this process's environment, so that the processes it starts do not get
/// them. Before there are other threads.
void ForgetCredentialVariables();

/// Nothing if `url` is "https://host[:port]", or "http://" with a host that is this machine (or any
/// if `allow_http`); otherwise what is wrong with it.
std::string WhyNotAnEndpoint(std::string_view url, bool allow_http);

/// Whether the host of "scheme://host[:port]" is this machine: localhost, 127.0.0.0/8 or [::1].
bool IsLoopback(std::string_view url);

}  // namespace strata::server
