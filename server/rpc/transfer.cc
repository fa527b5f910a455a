#include "server/rpc/transfer.h"

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

}  // namespace strata::server
