// strata.v1.Models and strata.v1.Jobs over gRPC.
#pragma once

#include "server/rpc/call_watch.h"
#include "server/service/service.h"
#include "strata/v1/jobs.grpc.pb.h"
#include "strata/v1/models.grpc.pb.h"

namespace strata::server {

/// Threads: gRPC's.
class ModelsRpc final : public v1::Models::Service {
 public:
  ModelsRpc(server::Service& service, CallWatch& watch) : service_(service), watch_(watch) {}

  grpc::Status Put(grpc::ServerContext* context, grpc::ServerReader<v1::PutModelRequest>* stream,
                   v1::Model* model) override;
  grpc::Status Get(grpc::ServerContext* context, const v1::GetModelRequest* request,
                   v1::Model* model) override;
  grpc::Status List(grpc::ServerContext* context, const v1::ListModelsRequest* request,
                    v1::ListModelsResponse* response) override;
  grpc::Status Delete(grpc::ServerContext* context, const v1::DeleteModelRequest* request,
                      google::protobuf::Empty* nothing) override;
  grpc::Status Download(grpc::ServerContext* context, const v1::DownloadModelRequest* request,
                        grpc::ServerWriter<v1::ContentChunk>* stream) override;

 private:
  server::Service& service_;
  CallWatch& watch_;
};

/// Threads: gRPC's.
class JobsRpc final : public v1::Jobs::Service {
 public:
  JobsRpc(server::Service& service, CallWatch& watch) : service_(service), watch_(watch) {}

  grpc::Status Create(grpc::ServerContext* context, const v1::CreateJobRequest* request,
                      v1::Job* job) override;
  grpc::Status Get(grpc::ServerContext* context, const v1::GetJobRequest* request,
                   v1::Job* job) override;
  grpc::Status List(grpc::ServerContext* context, const v1::ListJobsRequest* request,
                    v1::ListJobsResponse* response) override;
  grpc::Status Cancel(grpc::ServerContext* context, const v1::CancelJobRequest* request,
                      v1::Job* job) override;
  grpc::Status Wait(grpc::ServerContext* context, const v1::WaitJobRequest* request,
                    v1::Job* job) override;
  grpc::Status Watch(grpc::ServerContext* context, const v1::WatchJobRequest* request,
                     grpc::ServerWriter<v1::JobEvent>* stream) override;
  grpc::Status Download(grpc::ServerContext* context, const v1::DownloadResultRequest* request,
                        grpc::ServerWriter<v1::ContentChunk>* stream) override;

 private:
  server::Service& service_;
  CallWatch& watch_;
};

}  // namespace strata::server
