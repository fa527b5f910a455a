#include "server/rpc/batch_rpc.h"

#include <string>
#include <utility>

#include "server/batch/batch_service.h"
#include "server/rpc/transfer.h"

namespace strata::server {
namespace {

/// A call of one request and one response: `work` maps the batches to an Answer<Response>.
template <class Response, class Work>
grpc::Status Unary(const CallFrame& frame, Response* response, Work work) {
  return RunCall(frame, [&](CallBytes&) -> Answer<void> {
    const auto batches = frame.service.batches();
    if (!batches) return Pass(batches);
    auto answer = work(**batches);
    if (!answer) return Pass(answer);
    *response = *std::move(answer);
    return {};
  });
}

/// A call that is answered with content: `work` maps the batches to an Answer<Content>.
template <class Work>
grpc::Status Send(const CallFrame& frame, CallWatch& watch,
                  grpc::ServerWriter<v1::ContentChunk>& stream, Work work) {
  return RunCall(frame, [&](CallBytes& bytes) -> Answer<void> {
    const auto batches = frame.service.batches();
    if (!batches) return Pass(batches);
    const Answer<Content> content = work(**batches);
    if (!content) return Pass(content);
    return SendContent(watch, frame.context, *content, 0, bytes, [&stream](std::string& piece) {
      v1::ContentChunk chunk;
      chunk.mutable_data()->swap(piece);
      const bool taken = stream.Write(chunk);
      chunk.mutable_data()->swap(piece);
      return taken;
    });
  });
}

}  // namespace

grpc::Status BatchesRpc::Create(grpc::ServerContext* context, const v1::CreateBatchRequest* request,
                                v1::Batch* batch) {
  return Unary({service_, *context, "strata.v1.Batches/Create", Role::kFull}, batch,
               [&](BatchService& batches) { return batches.Create(*request); });
}

grpc::Status BatchesRpc::Get(grpc::ServerContext* context, const v1::GetBatchRequest* request,
                             v1::Batch* batch) {
  return Unary({service_, *context, "strata.v1.Batches/Get", Role::kRead}, batch,
               [&](BatchService& batches) { return batches.Get(request->id()); });
}

grpc::Status BatchesRpc::List(grpc::ServerContext* context, const v1::ListBatchesRequest* request,
                              v1::ListBatchesResponse* response) {
  return Unary({service_, *context, "strata.v1.Batches/List", Role::kRead}, response,
               [&](BatchService& batches) { return batches.List(*request); });
}

grpc::Status BatchesRpc::Cancel(grpc::ServerContext* context, const v1::CancelBatchRequest* request,
                                v1::Batch* batch) {
  return Unary({service_, *context, "strata.v1.Batches/Cancel", Role::kFull}, batch,
               [&](BatchService& batches) { return batches.Cancel(request->id()); });
}

grpc::Status BatchesRpc::Watch(grpc::ServerContext* context, const v1::WatchBatchRequest* request,
                               grpc::ServerWriter<v1::BatchEvent>* stream) {
  return RunCall({service_, *context, "strata.v1.Batches/Watch", Role::kRead},
                 [&](CallBytes&) -> Answer<void> {
                   const auto batches = service_.batches();
                   if (!batches) return Pass(batches);
                   const auto tell = [stream](const v1::Batch& batch) {
                     v1::BatchEvent event;
                     *event.mutable_batch() = batch;
                     return stream->Write(event);
                   };
                   return (*batches)->Watch(request->id(), tell,
                                            [context] { return context->IsCancelled(); });
                 });
}

grpc::Status BatchesRpc::Manifest(grpc::ServerContext* context,
                                  const v1::DownloadManifestRequest* request,
                                  grpc::ServerWriter<v1::ContentChunk>* stream) {
  return Send({service_, *context, "strata.v1.Batches/Manifest", Role::kRead}, watch_, *stream,
              [&](BatchService& batches) { return batches.OpenManifest(request->id()); });
}

grpc::Status BatchesRpc::Download(grpc::ServerContext* context,
                                  const v1::DownloadOutputRequest* request,
                                  grpc::ServerWriter<v1::ContentChunk>* stream) {
  return Send(
      {service_, *context, "strata.v1.Batches/Download", Role::kRead}, watch_, *stream,
      [&](BatchService& batches) { return batches.OpenOutput(request->id(), request->path()); });
}

}  // namespace strata::server
