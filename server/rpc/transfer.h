// Bytes in and out of a stream, chunk by chunk.
#pragma once

#include <algorithm>
#include <string>

#include "server/rpc/call.h"
#include "server/rpc/call_watch.h"

namespace strata::server {

inline constexpr std::size_t kMostChunk = std::size_t{1} << 20;

/// Why a stream ended before its time.
tl::unexpected<Problem> RefuseTransfer(const CallWatch& watch, const CallWatch::Transfer& transfer);

/// Refuses kMalformed unless a chunk has 1 to kMostChunk bytes.
Answer<void> CheckChunk(const std::string& chunk);

/// Sends `content` from `offset` in chunks; `send` gives one to the stream and says whether it took
/// it.
template <class Send>
Answer<void> SendContent(CallWatch& watch, grpc::ServerContext& context, const Content& content,
                         std::uint64_t offset, CallBytes& bytes, Send send) {
  CallWatch::Transfer transfer(watch, context);
  std::string chunk;
  for (std::uint64_t sent = offset; sent < content.size;) {
    chunk.resize(std::min<std::uint64_t>(kMostChunk, content.size - sent));
    if (const auto read = content.read(sent, chunk); !read) return Refuse(read.error());
    sent += chunk.size();
    if (!send(chunk)) return RefuseTransfer(watch, transfer);
    transfer.Add(chunk.size());
    bytes.out += chunk.size();
  }
  return {};
}

}  // namespace strata::server
