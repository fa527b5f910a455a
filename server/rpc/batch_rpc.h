// strata.v1.Batches over gRPC.
#pragma once

#include "server/rpc/call_watch.h"
#include "server/service/service.h"
#include "strata/v1/batches.grpc.pb.h"

namespace strata::server {

/// Threads: gRPC's.
class BatchesRpc final : public v1::Batches::Service {
 public:
  BatchesRpc(server::Service& service, CallWatch& watch) : service_(service), watch_(watch) {}

  grpc::Status Create(grpc::ServerContext* context, const v1::CreateBatchRequest* request,
                      v1::Batch* batch) override;
  grpc::Status Get(grpc::ServerContext* context, const v1::GetBatchRequest* request,
                   v1::Batch* batch) override;
  grpc::Status List(grpc::ServerContext* context, const v1::ListBatchesRequest* request,
                    v1::ListBatchesResponse* response) override;
  grpc::Status Cancel(grpc::ServerContext* context, const v1::CancelBatchRequest* request,
                      v1::Batch* batch) override;
  grpc::Status Watch(grpc::ServerContext* context, const v1::WatchBatchRequest* request,
                     grpc::ServerWriter<v1::BatchEvent>* stream) override;
  grpc::Status Manifest(grpc::ServerContext* context, const v1::DownloadManifestRequest* request,
                        grpc::ServerWriter<v1::ContentChunk>* stream) override;
  grpc::Status Download(grpc::ServerContext* context, const v1::DownloadOutputRequest* request,
                        grpc::ServerWriter<v1::ContentChunk>* stream) override;

 private:
  server::Service& service_;
  CallWatch& watch_;
};

}  // namespace strata::server
