#include "server/rpc/call.h"

#include <exception>

#include "server/service/log.h"
#include "server/service/request_id.h"

namespace strata::server {
namespace {

std::string MetadataOf(const grpc::ServerContext& context, const char* name) {
  const auto& all = context.client_metadata();
  const auto found = all.find(name);
  return found == all.end() ? std::string()
                            : std::string(found->second.data(), found->second.size());
}

Answer<void> RunAdmitted(const CallFrame& frame, std::string& caller_name, CallBytes& bytes,
                         const std::function<Answer<void>(CallBytes&)>& work) {
  const auto caller =
      frame.service.keys().Check(MetadataOf(frame.context, "authorization"), frame.needed);
  if (!caller) return Pass(caller);
  caller_name = caller->name;
  if (frame.client) *frame.client = caller->name;
  const auto slot = frame.service.Enter();
  if (!slot) return Pass(slot);
  try {
    return work(bytes);
  } catch (const std::bad_alloc&) {
    return Refuse(Refusal::kUnavailable, "the service is out of memory", 5);
  } catch (const std::exception& error) {
    return Refuse(Error{ErrorCode::kInternal, std::string("unexpected: ") + error.what()});
  }
}

}  // namespace

grpc::Status StatusOf(const Problem& problem, const std::string& request_id) {
  const v1::Problem message = ToMessage(problem, request_id);
  v1::ErrorStatus details;
  details.set_code(problem.grpc_status);
  details.set_message(message.detail());
  details.add_details()->PackFrom(message);
  return {static_cast<grpc::StatusCode>(problem.grpc_status), message.detail(),
          details.SerializeAsString()};
}

grpc::Status RunCall(const CallFrame& frame, const std::function<Answer<void>(CallBytes&)>& work) {
  const auto start = std::chrono::steady_clock::now();
  const std::string request_id = RequestIdOf(MetadataOf(frame.context, "x-request-id"));
  frame.context.AddInitialMetadata("x-request-id", request_id);
  CallBytes bytes;
  std::string caller = "none";
  const Answer<void> outcome = RunAdmitted(frame, caller, bytes, work);
  const int status = outcome ? 0 : outcome.error().grpc_status;
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  frame.service.metrics().Count({"grpc", frame.endpoint, status, seconds, bytes.in, bytes.out});
  Log(LogLevel::kInfo, "request",
      {{"protocol", "grpc"},
       {"request_id", request_id},
       {"method", frame.endpoint},
       {"status", static_cast<std::uint64_t>(status)},
       {"seconds", seconds},
       {"bytes_in", bytes.in},
       {"bytes_out", bytes.out},
       {"peer", frame.context.peer()},
       {"caller", caller},
       {"traceparent", TraceParentOf(MetadataOf(frame.context, "traceparent"))}});
  return outcome ? grpc::Status::OK : StatusOf(outcome.error(), request_id);
}

}  // namespace strata::server
