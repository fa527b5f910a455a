#include "server/rpc/sampling_rpc.h"

#include <algorithm>
#include <string>
#include <vector>

#include "server/rpc/transfer.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

using Stream = grpc::ServerReaderWriter<v1::SampleResponse, v1::SampleRequest>;

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
    const auto sampled = Sample(*upload, watch);
    if (!sampled) return Pass(sampled);
    return Send(*sampled, bytes);
  }

 private:
  Answer<Sampled> Sample(const Upload& upload, const JobWatch& watch) {
    if (!header_.has_model()) {
      return service_.Sample(header_.options(), upload.file().descriptor(), "body", watch);
    }
    const auto stored = service_.stored();
    if (!stored) return Pass(stored);
    return (*stored)->SampleModel(header_.options(), header_.model(), watch);
  }

  Answer<void> Receive(Upload& upload, CallBytes& bytes) {
    CallWatch::Transfer transfer(watch_, context_);
    v1::SampleRequest request;
    auto more = ReadNext(stream_, request, watch_, transfer);
    if (!more) return Pass(more);
    if (!*more) return Refuse(Refusal::kMalformed, "the stream is empty, expected a header first");
    if (!request.has_header()) {
      return Refuse(Refusal::kMalformed, "found a chunk, expected a header first");
    }
    header_ = std::move(*request.mutable_header());
    while ((more = ReadNext(stream_, request, watch_, transfer)) && *more) {
      if (auto taken = Take(request, upload); !taken) return taken;
      transfer.Add(request.chunk().size());
      bytes.in += request.chunk().size();
    }
    if (!more) return Pass(more);
    if (header_.has_model() != (upload.file().size() == 0)) {
      if (header_.has_model()) return Refuse(Refusal::kMalformed, "found a model and chunks");
      return Refuse(Refusal::kMalformed, "no chunk came, expected the bytes of a mesh file");
    }
    return {};
  }

  static Answer<void> Take(const v1::SampleRequest& request, Upload& upload) {
    if (!request.has_chunk()) {
      return Refuse(Refusal::kMalformed, "found a second header, expected a chunk");
    }
    if (auto good = CheckChunk(request.chunk()); !good) return good;
    return upload.Append(request.chunk());
  }

  void Report(const v1::Progress& progress) {
    v1::SampleResponse response;
    *response.mutable_progress() = progress;
    // A client that has gone, or does not read, shows as cancelled.
    static_cast<void>(WriteNext(stream_, response, watch_, context_));
  }

  Answer<void> Send(const Sampled& sampled, CallBytes& bytes) {
    v1::SampleResponse response;
    auto sent = SendContent(watch_, context_, sampled.content, 0, bytes, [&](std::string& chunk) {
      response.mutable_chunk()->swap(chunk);
      const bool taken = stream_.Write(response);
      response.mutable_chunk()->swap(chunk);
      return taken;
    });
    if (!sent) return sent;
    *response.mutable_summary() = sampled.summary;
    return WriteNext(stream_, response, watch_, context_);
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
