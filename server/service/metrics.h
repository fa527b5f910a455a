// What /metrics tells.
#pragma once

#include <memory>
#include <string>

namespace strata::server {

/// One request that was answered.
struct RequestFigures {
  const char* protocol;  ///< "http" or "grpc".
  std::string endpoint;  ///< Of the few the server has, never a client's text.
  int status;            ///< HTTP or gRPC status.
  double seconds;
  std::uint64_t bytes_in, bytes_out;  ///< Of bodies.
};

/// The process's counters. Threads: any.
class Metrics {
 public:
  Metrics();
  ~Metrics();

  void Count(const RequestFigures& request);
  void CountJob(const char* outcome, double seconds, std::uint64_t samples);
  void SetJobs(std::uint64_t running, std::uint64_t queued, std::uint64_t memory_bytes);
  void AddConnections(const char* protocol, int change);
  void CountCache(bool hit);

  /// The text exposition format, version 0.0.4.
  std::string Text() const;

 private:
  struct Families;
  std::unique_ptr<Families> families_;
};

}  // namespace strata::server
