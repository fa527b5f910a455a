#include "server/rpc/sampling_rpc.h"

#include <algorithm>
#include <string>
#include <vector>

#include "server/rpc/call.h"

namespace strata::server {
namespace {

using Stream = grpc::ServerReaderWriter<v1::SampleResponse, v1::SampleRequest>;
constexpr std::size_t kMostChunk = std::size_t{1} << 20;

tl::unexpected<Problem> RefuseTransfer(const CallWatch& watch,
                                       const CallWatch::Transfer& transfer) {
  if (!transfer.too_slow()) return Refuse(Error{ErrorCode::kCancelled, "the client went away"});
  return Refuse(Refusal::kTooSlow, "slower than " + std::to_string(watch.rate().bytes_per_second) +
                                       " bytes a second after " + std::to_string(transfer.bytes()) +
                                       " bytes");
}

/// The steps of one Sample call.
class SampleCall {
 public:
  SampleCall(Service& service, CallWatch& watch, grpc::ServerContext& context, Stream& stream)
      : service_(service), watch_(watch), context_(context), stream_(stream) {}

  Answer<void> Run(CallBytes& bytes) {
    auto upload = service_.BeginUpload();
    if (!upload) return Pass(upload);
    if (auto received = Receive(*upload, bytes); !received) return received;
    JobWatch watch;
    watch.gone = [this] { return context_.IsCancelled(); };
    watch.progress = [this](const v1::Progress& progress) { Report(progress); };
    const auto sampled = service_.Sample(header_.options(), upload->file(), "body", watch);
    if (!sampled) return Pass(sampled);
    return Send(*sampled, bytes);
  }

 private:
  Answer<void> Receive(Upload& upload, CallBytes& bytes) {
    CallWatch::Transfer transfer(watch_, context_);
    v1::SampleRequest request;
    if (!stream_.Read(&request)) {
      if (context_.IsCancelled()) return RefuseTransfer(watch_, transfer);
      return Refuse(Refusal::kMalformed, "the stream is empty, expected a header first");
    }
    if (!request.has_header()) {
      return Refuse(Refusal::kMalformed, "found a chunk, expected a header first");
    }
    header_ = std::move(*request.mutable_header());
    if (header_.has_model()) {
      return Refuse(Refusal::kNotImplemented, "this server stores no models");
    }
    while (stream_.Read(&request)) {
      if (auto taken = Take(request, upload); !taken) return taken;
      transfer.Add(request.chunk().size());
      bytes.in += request.chunk().size();
    }
    if (context_.IsCancelled()) return RefuseTransfer(watch_, transfer);
    if (upload.file().size() == 0) {
      return Refuse(Refusal::kMalformed, "no chunk came, expected the bytes of a mesh file");
    }
    return {};
  }

  static Answer<void> Take(const v1::SampleRequest& request, Upload& upload) {
    if (!request.has_chunk()) {
      return Refuse(Refusal::kMalformed, "found a second header, expected a chunk");
    }
    if (request.chunk().empty() || request.chunk().size() > kMostChunk) {
      return Refuse(Refusal::kMalformed, "found a chunk of " +
                                             std::to_string(request.chunk().size()) +
                                             " bytes, expected 1 to 1048576");
    }
    return upload.Append(request.chunk());
  }

  void Report(const v1::Progress& progress) {
    v1::SampleResponse response;
    *response.mutable_progress() = progress;
    stream_.Write(response);  // A client that has gone shows as cancelled.
  }

  Answer<void> Send(const Sampled& sampled, CallBytes& bytes) {
    CallWatch::Transfer transfer(watch_, context_);
    const std::uint64_t size = sampled.summary.size_bytes();
    v1::SampleResponse response;
    for (std::uint64_t sent = 0; sent < size;) {
      std::string& chunk = *response.mutable_chunk();
      chunk.resize(std::min<std::uint64_t>(kMostChunk, size - sent));
      if (const auto read = sampled.file->ReadAt(sent, chunk); !read) return Refuse(read.error());
      if (!stream_.Write(response)) return RefuseTransfer(watch_, transfer);
      sent += chunk.size();
      transfer.Add(chunk.size());
      bytes.out += chunk.size();
    }
    *response.mutable_summary() = sampled.summary;
    if (!stream_.Write(response)) return RefuseTransfer(watch_, transfer);
    return {};
  }

  Service& service_;
  CallWatch& watch_;
  grpc::ServerContext& context_;
  Stream& stream_;
  v1::SampleHeader header_;
};

}  // namespace

grpc::Status SamplingRpc::Sample(grpc::ServerContext* context, Stream* stream) {
  return RunCall(
      {service_, *context, "strata.v1.Sampling/Sample", Role::kFull},
      [&](CallBytes& bytes) { return SampleCall(service_, watch_, *context, *stream).Run(bytes); });
}

}  // namespace strata::server
