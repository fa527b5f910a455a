#include "server/service/metrics.h"

#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>
#include <prometheus/text_serializer.h>

#include <sstream>
#include <string>

#include "core/version.h"

namespace strata::server {
namespace {

using prometheus::BuildCounter;
using prometheus::BuildGauge;
using prometheus::BuildHistogram;

// From a cached answer to a job of minutes, by about the factor three.
const prometheus::Histogram::BucketBoundaries kSeconds = {0.001, 0.003, 0.01, 0.03, 0.1, 0.3,
                                                          1,     3,     10,   30,   100, 300};

prometheus::Family<prometheus::Counter>& CounterOf(prometheus::Registry& registry, const char* name,
                                                   const char* help) {
  return BuildCounter().Name(name).Help(help).Register(registry);
}

prometheus::Family<prometheus::Gauge>& GaugeOf(prometheus::Registry& registry, const char* name,
                                               const char* help) {
  return BuildGauge().Name(name).Help(help).Register(registry);
}

prometheus::Family<prometheus::Histogram>& HistogramOf(prometheus::Registry& registry,
                                                       const char* name, const char* help) {
  return BuildHistogram().Name(name).Help(help).Register(registry);
}

double AsDouble(std::uint64_t n) { return static_cast<double>(n); }

}  // namespace

struct Metrics::Families {
  prometheus::Registry registry;
  prometheus::Family<prometheus::Counter>& requests =
      CounterOf(registry, "strata_requests_total", "Requests answered, by endpoint and status.");
  prometheus::Family<prometheus::Histogram>& request_seconds =
      HistogramOf(registry, "strata_request_seconds", "Wall time of requests, body included.");
  prometheus::Family<prometheus::Counter>& bytes =
      CounterOf(registry, "strata_body_bytes_total", "Bytes of bodies, by direction.");
  prometheus::Family<prometheus::Counter>& jobs =
      CounterOf(registry, "strata_jobs_total", "Sampling jobs that ended, by outcome.");
  prometheus::Family<prometheus::Histogram>& job_seconds =
      HistogramOf(registry, "strata_job_seconds", "Wall time of sampling jobs, waiting excluded.");
  prometheus::Counter& samples =
      CounterOf(registry, "strata_samples_total", "Samples drawn; its rate is samples per second.")
          .Add({});
  prometheus::Gauge& running =
      GaugeOf(registry, "strata_jobs_running", "Sampling jobs that run.").Add({});
  prometheus::Gauge& queued =
      GaugeOf(registry, "strata_jobs_waiting", "Sampling jobs that wait for their turn.").Add({});
  prometheus::Gauge& memory =
      GaugeOf(registry, "strata_job_memory_bytes", "Memory promised to running jobs.").Add({});
  prometheus::Family<prometheus::Gauge>& connections =
      GaugeOf(registry, "strata_connections", "Open connections, by protocol.");
  prometheus::Family<prometheus::Counter>& cache =
      CounterOf(registry, "strata_cache_total", "Results looked up in the cache, by outcome.");
};

Metrics::Metrics() : families_(std::make_unique<Families>()) {
  GaugeOf(families_->registry, "strata_info", "1, with the version.")
      .Add({{"version", std::string(kVersion)}})
      .Set(1);
  // Present from the start, so that a rate has a beginning.
  for (const char* outcome : {"succeeded", "failed", "cancelled"}) {
    families_->jobs.Add({{"outcome", outcome}});
  }
  for (const char* outcome : {"hit", "miss"}) families_->cache.Add({{"outcome", outcome}});
}
Metrics::~Metrics() = default;

void Metrics::Count(const RequestFigures& request) {
  const prometheus::Labels where = {{"protocol", request.protocol}, {"endpoint", request.endpoint}};
  prometheus::Labels all = where;
  all["status"] = std::to_string(request.status);
  families_->requests.Add(all).Increment();
  families_->request_seconds.Add(where, kSeconds).Observe(request.seconds);
  families_->bytes.Add({{"direction", "in"}}).Increment(AsDouble(request.bytes_in));
  families_->bytes.Add({{"direction", "out"}}).Increment(AsDouble(request.bytes_out));
}

void Metrics::CountJob(const char* outcome, double seconds, std::uint64_t samples) {
  families_->jobs.Add({{"outcome", outcome}}).Increment();
  families_->job_seconds.Add({}, kSeconds).Observe(seconds);
  families_->samples.Increment(AsDouble(samples));
}

void Metrics::SetJobs(std::uint64_t running, std::uint64_t queued, std::uint64_t memory_bytes) {
  families_->running.Set(AsDouble(running));
  families_->queued.Set(AsDouble(queued));
  families_->memory.Set(AsDouble(memory_bytes));
}

void Metrics::AddConnections(const char* protocol, int change) {
  families_->connections.Add({{"protocol", protocol}}).Increment(change);
}

void Metrics::CountCache(bool hit) {
  families_->cache.Add({{"outcome", hit ? "hit" : "miss"}}).Increment();
}

std::string Metrics::Text() const {
  std::ostringstream text;
  prometheus::TextSerializer().Serialize(text, families_->registry.Collect());
  return text.str();
}

}  // namespace strata::server
