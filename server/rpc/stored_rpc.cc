#include "server/rpc/stored_rpc.h"

#include <google/protobuf/util/time_util.h>

#include <algorithm>

#include "server/rpc/transfer.h"
#include "server/service/stored_service.h"

namespace strata::server {
namespace {

/// A call of one request and one response: `work` maps the stores to an Answer<Response>.
template <class Response, class Work>
grpc::Status Unary(const CallFrame& frame, Response* response, Work work) {
  return RunCall(frame, [&](CallBytes&) -> Answer<void> {
    const auto stored = frame.service.stored();
    if (!stored) return Pass(stored);
    auto answer = work(**stored);
    if (!answer) return Pass(answer);
    *response = *std::move(answer);
    return {};
  });
}

auto GoneOf(grpc::ServerContext& context) {
  return [&context] { return context.IsCancelled(); };
}

auto SinkOf(grpc::ServerWriter<v1::ContentChunk>& stream) {
  return [&stream](std::string& bytes) {
    v1::ContentChunk chunk;
    chunk.mutable_data()->swap(bytes);
    const bool taken = stream.Write(chunk);
    chunk.mutable_data()->swap(bytes);
    return taken;
  };
}

}  // namespace

// --- Models --------------------------------------------------------------------------------------

grpc::Status ModelsRpc::Put(grpc::ServerContext* context,
                            grpc::ServerReader<v1::PutModelRequest>* stream, v1::Model* model) {
  return RunCall(
      {service_, *context, "strata.v1.Models/Put", Role::kFull},
      [&](CallBytes& bytes) -> Answer<void> {
        const auto stored = service_.stored();
        if (!stored) return Pass(stored);
        CallWatch::Transfer transfer(watch_, *context);
        v1::PutModelRequest request;
        auto more = ReadNext(*stream, request, watch_, transfer);
        if (!more) return Pass(more);
        if (!request.has_header()) return Refuse(Refusal::kMalformed, "expected a header first");
        const v1::PutModelHeader header = request.header();
        const auto put = (*stored)->PutModel(header, {}, [&](const auto& sink) -> Answer<void> {
          while ((more = ReadNext(*stream, request, watch_, transfer)) && *more) {
            if (auto good = CheckChunk(request.chunk()); !good) return good;
            bytes.in += request.chunk().size();
            transfer.Add(request.chunk().size());
            if (bytes.in > service_.limits().body_bytes) {
              return Refuse(Refusal::kBodyTooLarge,
                            "the model is larger than the " +
                                std::to_string(service_.limits().body_bytes) + " bytes allowed");
            }
            if (auto taken = sink(request.chunk()); !taken) return taken;
          }
          if (!more) return Pass(more);
          return {};
        });
        if (!put) return Pass(put);
        *model = put->model;
        return {};
      });
}

grpc::Status ModelsRpc::Get(grpc::ServerContext* context, const v1::GetModelRequest* request,
                            v1::Model* model) {
  return Unary({service_, *context, "strata.v1.Models/Get", Role::kRead}, model,
               [&](StoredService& stored) { return stored.GetModel(request->name()); });
}

grpc::Status ModelsRpc::List(grpc::ServerContext* context, const v1::ListModelsRequest* request,
                             v1::ListModelsResponse* response) {
  return Unary({service_, *context, "strata.v1.Models/List", Role::kRead}, response,
               [&](StoredService& stored) { return stored.ListModels(*request); });
}

grpc::Status ModelsRpc::Delete(grpc::ServerContext* context, const v1::DeleteModelRequest* request,
                               google::protobuf::Empty* nothing) {
  return Unary({service_, *context, "strata.v1.Models/Delete", Role::kFull}, nothing,
               [&](StoredService& stored) -> Answer<google::protobuf::Empty> {
                 const auto deleted = stored.DeleteModel(request->name(), {});
                 if (!deleted) return Pass(deleted);
                 return google::protobuf::Empty();
               });
}

grpc::Status ModelsRpc::Download(grpc::ServerContext* context,
                                 const v1::DownloadModelRequest* request,
                                 grpc::ServerWriter<v1::ContentChunk>* stream) {
  return RunCall({service_, *context, "strata.v1.Models/Download", Role::kRead},
                 [&](CallBytes& bytes) -> Answer<void> {
                   const auto stored = service_.stored();
                   if (!stored) return Pass(stored);
                   const auto content = (*stored)->OpenModelContent(request->name());
                   if (!content) return Pass(content);
                   return SendContent(watch_, *context, *content, 0, bytes, SinkOf(*stream));
                 });
}

// --- Jobs ----------------------------------------------------------------------------------------

grpc::Status JobsRpc::Create(grpc::ServerContext* context, const v1::CreateJobRequest* request,
                             v1::Job* job) {
  std::string client;
  return Unary({service_, *context, "strata.v1.Jobs/Create", Role::kFull, &client}, job,
               [&](StoredService& stored) -> Answer<v1::Job> {
                 auto created = stored.CreateJob(*request, client);
                 if (!created) return Pass(created);
                 return std::move(created->job);
               });
}

grpc::Status JobsRpc::Get(grpc::ServerContext* context, const v1::GetJobRequest* request,
                          v1::Job* job) {
  return Unary({service_, *context, "strata.v1.Jobs/Get", Role::kRead}, job,
               [&](StoredService& stored) { return stored.GetJob(request->id()); });
}

grpc::Status JobsRpc::List(grpc::ServerContext* context, const v1::ListJobsRequest* request,
                           v1::ListJobsResponse* response) {
  return Unary({service_, *context, "strata.v1.Jobs/List", Role::kRead}, response,
               [&](StoredService& stored) { return stored.ListJobs(*request); });
}

grpc::Status JobsRpc::Cancel(grpc::ServerContext* context, const v1::CancelJobRequest* request,
                             v1::Job* job) {
  return Unary({service_, *context, "strata.v1.Jobs/Cancel", Role::kFull}, job,
               [&](StoredService& stored) { return stored.CancelJob(request->id()); });
}

grpc::Status JobsRpc::Wait(grpc::ServerContext* context, const v1::WaitJobRequest* request,
                           v1::Job* job) {
  constexpr std::int64_t kUsual = 30'000, kMost = 3'600'000;
  // Looked at before it is counted in milliseconds, which a larger one would overflow.
  const bool in_range = request->timeout().seconds() >= 0 && request->timeout().seconds() <= kMost;
  return Unary(
      {service_, *context, "strata.v1.Jobs/Wait", Role::kRead}, job,
      [&](StoredService& stored) -> Answer<v1::Job> {
        const std::int64_t asked =
            request->has_timeout() && in_range
                ? google::protobuf::util::TimeUtil::DurationToMilliseconds(request->timeout())
                : kUsual;
        if (!in_range || asked < 0 || asked > kMost) {
          return Refuse(Error{ErrorCode::kInvalidArgument, "timeout: expected 0 to 3600 seconds"});
        }
        return stored.WaitJob(request->id(), std::chrono::milliseconds(asked), GoneOf(*context));
      });
}

grpc::Status JobsRpc::Watch(grpc::ServerContext* context, const v1::WatchJobRequest* request,
                            grpc::ServerWriter<v1::JobEvent>* stream) {
  return RunCall({service_, *context, "strata.v1.Jobs/Watch", Role::kRead},
                 [&](CallBytes&) -> Answer<void> {
                   const auto stored = service_.stored();
                   if (!stored) return Pass(stored);
                   return (*stored)->WatchJob(
                       *request,
                       [&](const v1::JobEvent& event) {
                         return WriteNext(*stream, event, watch_, *context).has_value();
                       },
                       GoneOf(*context));
                 });
}

grpc::Status JobsRpc::Download(grpc::ServerContext* context,
                               const v1::DownloadResultRequest* request,
                               grpc::ServerWriter<v1::ContentChunk>* stream) {
  return RunCall({service_, *context, "strata.v1.Jobs/Download", Role::kRead},
                 [&](CallBytes& bytes) -> Answer<void> {
                   const auto stored = service_.stored();
                   if (!stored) return Pass(stored);
                   const auto result = (*stored)->OpenResult(request->id());
                   if (!result) return Pass(result);
                   if (request->offset() > result->content.size) {
                     return Refuse(Refusal::kRange,
                                   "there are " + std::to_string(result->content.size) + " bytes");
                   }
                   return SendContent(watch_, *context, result->content, request->offset(), bytes,
                                      SinkOf(*stream));
                 });
}

}  // namespace strata::server
