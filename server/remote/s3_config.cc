#include "server/remote/s3_config.h"

#include <algorithm>
#include <boost/property_tree/ini_parser.hpp>
#include <boost/property_tree/ptree.hpp>
#include <charconv>
#include <cstdlib>
#include <fstream>
#include <map>

#include "io/quote.h"

namespace strata::server {
namespace {

using Profile = std::map<std::string, std::string>;

std::string Read(const Environment& environment, const char* name) {
  const char* const value = environment(name);
  return value != nullptr ? value : "";
}

/// The first of the variables that is set.
template <class... Names>
std::string ReadFirst(const Environment& environment, Names... names) {
  std::string found;
  for (const char* const name : {names...}) {
    if (found.empty()) found = Read(environment, name);
  }
  return found;
}

/// The section of a profile in one file; empty if there is no such file or section. `named`: the
/// file was asked for, and must be there.
Result<Profile> ReadProfile(const std::string& path, bool named, const std::string& section) {
  std::ifstream file(path);
  if (!file) {
    if (!named) return Profile{};
    return Fail(ErrorCode::kNotFound, path + ": cannot open the file of AWS settings");
  }
  boost::property_tree::ptree tree;
  try {
    boost::property_tree::read_ini(file, tree);
  } catch (const boost::property_tree::ini_parser_error& error) {
    // what() would be fine today; a later one might quote the line.
    return Fail(ErrorCode::kCorruptInput,
                path + ":" + std::to_string(error.line()) + ": expected [section] or name = value");
  }
  Profile profile;
  for (const auto& [name, values] : tree) {
    if (name != section) continue;
    for (const auto& [key, value] : values) profile[key] = value.data();
  }
  return profile;
}

struct Profiles {
  std::string name;
  Profile credentials, config;

  std::string Find(const std::string& key) const {
    for (const Profile* profile : {&credentials, &config}) {
      if (const auto found = profile->find(key); found != profile->end()) return found->second;
    }
    return {};
  }
};

Result<Profiles> ReadProfiles(const Environment& environment) {
  Profiles profiles;
  const std::string chosen = ReadFirst(environment, "AWS_PROFILE", "AWS_DEFAULT_PROFILE");
  profiles.name = chosen.empty() ? "default" : chosen;
  const std::string home = Read(environment, "HOME");
  const auto read = [&](const char* variable, const char* usual, const std::string& section) {
    const std::string named = Read(environment, variable);
    return ReadProfile(named.empty() ? home + usual : named, !named.empty(), section);
  };
  Result<Profile> credentials =
      read("AWS_SHARED_CREDENTIALS_FILE", "/.aws/credentials", profiles.name);
  if (!credentials) return Forward(credentials);
  const std::string section =
      profiles.name == "default" ? profiles.name : "profile " + profiles.name;
  Result<Profile> config = read("AWS_CONFIG_FILE", "/.aws/config", section);
  if (!config) return Forward(config);
  profiles.credentials = std::move(*credentials);
  profiles.config = std::move(*config);
  return profiles;
}

/// What goes into a header must be a part of it: printable, no line's end.
bool IsHeaderText(std::string_view text) {
  return std::ranges::all_of(text, [](char c) { return c > ' ' && c <= '~'; });
}

tl::unexpected<Error> FailNoCredentials(const Profiles& profiles) {
  const std::string where = "profile " + io::Quoted(profiles.name);
  for (const char* const other : {"credential_process", "role_arn", "sso_session", "sso_start_url",
                                  "web_identity_token_file", "credential_source"}) {
    if (profiles.Find(other).empty()) continue;
    return Fail(ErrorCode::kInvalidArgument,
                where + " gets its credentials by " + other +
                    ", which Strata does not do: set AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY and "
                    "AWS_SESSION_TOKEN to what that gives");
  }
  return Fail(ErrorCode::kInvalidArgument,
              "no credentials for s3://: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or have "
              "them in ~/.aws/credentials (" +
                  where + ")");
}

Result<void> SetCredentials(const Environment& environment, const Profiles& profiles,
                            S3Config& config) {
  config.access_key = Read(environment, "AWS_ACCESS_KEY_ID");
  config.secret_key = Read(environment, "AWS_SECRET_ACCESS_KEY");
  config.session_token = Read(environment, "AWS_SESSION_TOKEN");
  if (config.access_key.empty() != config.secret_key.empty()) {
    return Fail(ErrorCode::kInvalidArgument,
                "of AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY one is set and one is not");
  }
  for (const Profile* profile : {&profiles.credentials, &profiles.config}) {
    if (!config.access_key.empty()) break;
    const auto find = [&](const char* key) {
      const auto found = profile->find(key);
      return found != profile->end() ? found->second : std::string();
    };
    config.access_key = find("aws_access_key_id");
    config.secret_key = find("aws_secret_access_key");
    config.session_token = find("aws_session_token");
  }
  if (config.access_key.empty() || config.secret_key.empty()) return FailNoCredentials(profiles);
  // A key from a file read with its line's end would otherwise be refused by the store,
  // unexplained.
  if (!IsHeaderText(config.access_key) || !IsHeaderText(config.secret_key) ||
      !IsHeaderText(config.session_token)) {
    return Fail(ErrorCode::kInvalidArgument,
                "the credentials for s3:// hold a blank or a character that is not printable");
  }
  return {};
}

Result<void> SetPlace(const Environment& environment, const Profiles& profiles, S3Config& config) {
  std::string region = ReadFirst(environment, "AWS_REGION", "AWS_DEFAULT_REGION");
  if (region.empty()) region = profiles.Find("region");
  if (!region.empty()) config.region = region;
  const bool region_is_fine =
      config.region.size() <= 64 && std::ranges::all_of(config.region, [](char c) {
        return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '-';
      });
  if (!region_is_fine) {
    return Fail(ErrorCode::kInvalidArgument,
                "the region " + io::Quoted(config.region) +
                    " is not one: expected small letters, digits and '-'");
  }
  config.endpoint = ReadFirst(environment, "AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL");
  if (config.endpoint.empty()) config.endpoint = profiles.Find("endpoint_url");
  if (config.endpoint.ends_with('/')) config.endpoint.pop_back();
  if (!config.endpoint.empty()) {
    const std::string fault = WhyNotAnEndpoint(config.endpoint, config.allow_http);
    if (!fault.empty()) {
      return Fail(ErrorCode::kInvalidArgument,
                  "the endpoint for s3://, " + io::Quoted(config.endpoint) + ", " + fault);
    }
  }
  const std::string style = profiles.Find("addressing_style");
  config.virtual_hosts = style == "virtual" || (config.endpoint.empty() && style != "path");
  return {};
}

Result<void> SetAttempts(const Environment& environment, S3Config& config) {
  const std::string text = Read(environment, "AWS_MAX_ATTEMPTS");
  if (text.empty()) return {};
  const auto [end, error] =
      std::from_chars(text.data(), text.data() + text.size(), config.max_attempts);
  if (error == std::errc() && end == text.data() + text.size() && config.max_attempts >= 1 &&
      config.max_attempts <= 100) {
    return {};
  }
  return Fail(ErrorCode::kInvalidArgument,
              "AWS_MAX_ATTEMPTS is " + io::Quoted(text) + ": expected 1 to 100");
}

/// "host[:port]" of "scheme://host[:port]"; empty if there is no scheme.
std::string_view Authority(std::string_view url) {
  const std::size_t at = url.find("://");
  return at == std::string_view::npos ? std::string_view() : url.substr(at + 3);
}

std::string_view Host(std::string_view url) {
  const std::string_view authority = Authority(url);
  if (authority.starts_with('[')) {
    const std::size_t end = authority.find(']');
    return end == std::string_view::npos ? std::string_view() : authority.substr(0, end + 1);
  }
  return authority.substr(0, std::min(authority.find(':'), authority.size()));
}

bool IsIpv4Loopback(std::string_view host) {
  int parts = 0;
  for (std::size_t begin = 0; begin <= host.size(); ++parts) {
    const std::size_t end = std::min(host.find('.', begin), host.size());
    unsigned value = 256;
    const auto [stop, error] = std::from_chars(host.data() + begin, host.data() + end, value);
    if (error != std::errc() || stop != host.data() + end || value > 255) return false;
    if (parts == 0 && value != 127) return false;
    begin = end + 1;
  }
  return parts == 4;
}

}  // namespace

bool IsLoopback(std::string_view url) {
  const std::string_view host = Host(url);
  return host == "localhost" || host == "[::1]" || IsIpv4Loopback(host);
}

std::string WhyNotAnEndpoint(std::string_view url, bool allow_http) {
  const bool https = url.starts_with("https://");
  if (!https && !url.starts_with("http://")) return "is not https://HOST[:PORT]";
  const std::string_view authority = Authority(url);
  const bool plain = !Host(url).empty() && std::ranges::all_of(authority, [](char c) {
    return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '-' ||
           c == '.' || c == '_' || c == ':' || c == '[' || c == ']';
  });
  if (!plain) return "is not https://HOST[:PORT]: no user, path or query may follow";
  if (!https && !allow_http && !IsLoopback(url)) {
    return "is plain http to another machine, where everybody on the way reads and alters what is "
           "sent; --s3-insecure allows it";
  }
  return {};
}

Result<S3Config> LoadS3Config(const Environment& environment, bool allow_http) {
  const Result<Profiles> profiles = ReadProfiles(environment);
  if (!profiles) return Forward(profiles);
  S3Config config;
  config.allow_http = allow_http;
  config.ca_file = Read(environment, "AWS_CA_BUNDLE");
  for (const auto set : {SetCredentials, SetPlace}) {
    if (const Result<void> done = set(environment, *profiles, config); !done) return Forward(done);
  }
  if (const Result<void> done = SetAttempts(environment, config); !done) return Forward(done);
  return config;
}

void ForgetCredentialVariables() {
  for (const char* const name :
       {"AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN"}) {
    unsetenv(name);
  }
}

}  // namespace strata::server
