// Pieces that several endpoints have in common.
#pragma once

#include <google/protobuf/message.h>

#include <string>

#include "server/http/exchange.h"
#include "strata/v1/options.pb.h"

namespace strata::server {

/// Answers with a message as JSON: proto3's mapping, field names as in the proto.
void RespondMessage(Exchange& exchange, int status, const google::protobuf::Message& message,
                    const Headers& headers = {});

/// Fills a message from the query: each name is a field of it, given once, or several times where
/// it is repeated. Refuses: kInvalidArgument.
Answer<void> QueryInto(const RequestTarget& target, google::protobuf::Message& message);

/// Fills a message from a JSON body of at most 1 MiB. Refuses: kMediaType, kMalformed.
Answer<void> JsonBodyInto(Exchange& exchange, google::protobuf::Message& message);

/// Options from `query`, and the format from the Accept header where they have none.
Answer<v1::SampleOptions> SampleOptionsOf(
    const Exchange& exchange, const std::vector<std::pair<std::string, std::string>>& query);

/// A mesh file is sent as it is: what wraps it in something else is refused by name, because its
/// bytes would be read as a broken mesh. Refuses: kMediaType.
Answer<void> CheckMeshType(const Exchange& exchange);

/// The headers of a result.
Headers ResultHeaders(const Sampled& sampled);

/// For an endpoint without parameters: a misspelt or misplaced one is said, not passed over.
/// Refuses: kInvalidArgument.
Answer<void> CheckNoParameters(const RequestTarget& target);

/// What an endpoint without parameters works on. Refuses: what `source` refused; CheckNoParameters.
template <class T>
Answer<T> WithoutParameters(Answer<T> source, const Exchange& exchange) {
  if (!source) return source;
  if (auto none = CheckNoParameters(exchange.target()); !none) return Pass(none);
  return source;
}

/// The value of a name in the query, taken out of it; empty: not there.
std::string TakeFromQuery(std::vector<std::pair<std::string, std::string>>& query,
                          std::string_view name);

}  // namespace strata::server
