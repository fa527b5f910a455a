#include "server/rpc/transfer.h"

#include <google/protobuf/unknown_field_set.h>

namespace strata::server {

tl::unexpected<Problem> RefuseTransfer(const CallWatch& watch,
                                       const CallWatch::Transfer& transfer) {
  if (!transfer.too_slow()) return Refuse(Error{ErrorCode::kCancelled, "the client went away"});
  return Refuse(Refusal::kTooSlow, "slower than " + std::to_string(watch.rate().bytes_per_second) +
                                       " bytes a second after " + std::to_string(transfer.bytes()) +
                                       " bytes");
}

Answer<void> CheckChunk(const std::string& chunk) {
  if (!chunk.empty() && chunk.size() <= kMostChunk) return {};
  return Refuse(Refusal::kMalformed, "found a chunk of " + std::to_string(chunk.size()) +
                                         " bytes, expected 1 to 1048576");
}

namespace {
constexpr int kMark = 536'870'911;  // The largest number a field can have; no message has it.
}

void MarkUnread(google::protobuf::Message& message) {
  message.Clear();
  message.GetReflection()->MutableUnknownFields(&message)->AddVarint(kMark, 1);
}

bool FoundEnd(const google::protobuf::Message& message) {
  const auto& unknown = message.GetReflection()->GetUnknownFields(message);
  return unknown.field_count() == 1 && unknown.field(0).number() == kMark;
}

}  // namespace strata::server
