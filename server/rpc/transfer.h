// Bytes in and out of a stream, chunk by chunk.
#pragma once

#include <google/protobuf/message.h>

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

/// Marks `message` so that FoundEnd can tell what a read that failed has left of it.
void MarkUnread(google::protobuf::Message& message);
/// After a read that failed: whether the stream is at its end, rather than at bytes that are no
/// message. gRPC says the same of both, but only parsing touches the message.
bool FoundEnd(const google::protobuf::Message& message);

/// Reads the next message of a client's stream; false at its end. Refuses: kMalformed (no message
/// of this kind); what RefuseTransfer says.
template <class Stream, class Message>
Answer<bool> ReadNext(Stream& stream, Message& message, CallWatch& watch,
                      const CallWatch::Transfer& transfer) {
  MarkUnread(message);
  if (stream.Read(&message)) return true;
  if (transfer.cancelled()) return RefuseTransfer(watch, transfer);
  if (FoundEnd(message)) return false;
  return Refuse(Refusal::kMalformed, "found bytes that are no message, after " +
                                         std::to_string(transfer.bytes()) + " bytes of chunks");
}

/// Writes one message. Refuses: what RefuseTransfer says.
template <class Stream, class Message>
Answer<void> WriteNext(Stream& stream, const Message& message, CallWatch& watch,
                       grpc::ServerContext& context) {
  const CallWatch::Transfer transfer(watch, context);
  if (stream.Write(message)) return {};
  return RefuseTransfer(watch, transfer);
}

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
