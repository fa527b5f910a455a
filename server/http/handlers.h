// The handlers of the table in endpoints.cc: each translates a request into a call of the service
// and back.
#pragma once

#include <string>

#include "server/http/exchange.h"

namespace strata::server {

void PostSamples(Service& service, Exchange& exchange, const std::string& parameter);
void GetSamples(Service& service, Exchange& exchange, const std::string& parameter);

void ListModels(Service& service, Exchange& exchange, const std::string& parameter);
void PutModelFile(Service& service, Exchange& exchange, const std::string& name);
void GetModel(Service& service, Exchange& exchange, const std::string& name);
void DeleteModel(Service& service, Exchange& exchange, const std::string& name);

void PostJob(Service& service, Exchange& exchange, const std::string& parameter);
void ListJobs(Service& service, Exchange& exchange, const std::string& parameter);
void GetJob(Service& service, Exchange& exchange, const std::string& id);
void DeleteJob(Service& service, Exchange& exchange, const std::string& id);
void GetJobEvents(Service& service, Exchange& exchange, const std::string& id);
void GetJobResult(Service& service, Exchange& exchange, const std::string& id);

void PostBatch(Service& service, Exchange& exchange, const std::string& parameter);
void ListBatches(Service& service, Exchange& exchange, const std::string& parameter);
void GetBatch(Service& service, Exchange& exchange, const std::string& id);
void DeleteBatch(Service& service, Exchange& exchange, const std::string& id);
void GetBatchEvents(Service& service, Exchange& exchange, const std::string& id);
void GetBatchManifest(Service& service, Exchange& exchange, const std::string& id);
void GetBatchOutput(Service& service, Exchange& exchange, const std::string& id);

void TusOptions(Service& service, Exchange& exchange, const std::string& parameter);
void TusCreate(Service& service, Exchange& exchange, const std::string& parameter);
void TusHead(Service& service, Exchange& exchange, const std::string& id);
void TusPatch(Service& service, Exchange& exchange, const std::string& id);
void TusDelete(Service& service, Exchange& exchange, const std::string& id);

}  // namespace strata::server
