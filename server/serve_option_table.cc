#include "server/serve_option_table.h"

#include <algorithm>
#include <array>

namespace strata::server {
namespace {

constexpr const char* kWhere = "Where it listens";
constexpr const char* kWho = "Who may ask";
constexpr const char* kRequest = "One request";
constexpr const char* kAll = "All requests together";
constexpr const char* kJob = "Jobs";
constexpr const char* kStore = "What it keeps";
constexpr const char* kRun = "How it runs";

constexpr std::array<ServeOption, 43> kOptions = {{
    {"http", "ADDR:PORT", kWhere, "HTTP; port 0 takes any free one; off = no HTTP.",
     "127.0.0.1:8080"},
    {"grpc", "ADDR:PORT", kWhere, "gRPC; likewise.", "127.0.0.1:8081"},
    {"tls-certificate", "FILE", kWhere,
     "PEM: the server's certificate, its chain after it. With it and\n"
     "the key, both protocols are under TLS.",
     ""},
    {"tls-key", "FILE", kWhere, "PEM: its private key.", ""},
    {"tls-client-ca", "FILE", kWho,
     "PEM: clients must show a certificate that one of these signed.", ""},
    {"keys", "FILE", kWho,
     "API keys, as `strata key` prints them. Without keys everybody who\n"
     "reaches the service may use it.",
     ""},
    {"allowed-host", "NAME", kWho,
     "Without keys: a name, besides loopback's and its address, by which\n"
     "requests may call the service (Host) over HTTP. May be repeated.",
     "", nullptr, true},
    {"insecure", "on|off", kWho, "Listen beyond loopback although no keys are configured.", "off"},
    {"body-size", "SIZE", kRequest, "Largest body.", "4G"},
    {"header-size", "SIZE", kRequest, "Largest header (gRPC: metadata). 1K to 1M.", "16K"},
    {"header-fields", "N", kRequest, "Most header fields over HTTP. 1 to 10000.", "64"},
    {"header-timeout", "SECONDS", kRequest,
     "For a whole header over HTTP, and for a connection's handshake. 1 to 3600.", "10"},
    {"idle-timeout", "SECONDS", kRequest, "Between two requests of a connection. 1 to 86400.",
     "60"},
    {"min-rate", "BYTES", kRequest,
     "Bodies slower than this a second on average are ended, either way.\n"
     "1 to 1000000000.",
     "1024"},
    {"grace", "SECONDS", kRequest, "After the first of a body min-rate counts. 1 to 3600.", "10"},
    {"connections", "N", kAll, "Open at a time, over each protocol. 1 to 100000.", "512"},
    {"requests", "N", kAll, "In flight at a time; more are told to come again (429). 1 to 10000.",
     "384"},
    {"jobs", "N", kJob, "Run at a time; others wait. 1 to 1024.", "",
     "as many as processors, at least 2"},
    {"queue", "N", kJob, "Wait at a time; more are told to come again (503). 0 to 100000.", "256"},
    {"memory", "SIZE", kJob, "Of all jobs together. At least 64M.", "",
     "half of what this process may use"},
    {"job-memory", "SIZE", kJob, "Of one job. At least 64M.", "",
     "memory divided by jobs, at least 64M"},
    {"job-threads", "N", kJob, "Of one job; 0 = all processors. 0 to 1024.", "0"},
    {"job-time", "SECONDS", kJob, "For one job, waiting excluded. 1 to 1000000.", "600"},
    {"result-size", "SIZE", kJob, "Largest result.", "4G"},
    {"isolate", "on|off", kJob, "Each job in a process of its own, so that a crash ends one job.",
     "on"},
    {"data", "DIR", kStore,
     "Models, jobs and results, made if it is missing. Without it the\n"
     "service keeps nothing.",
     ""},
    {"blobs", "URL", kStore,
     "s3://BUCKET[/PREFIX]: where models and results lie instead of in data.\n"
     "Needs data, for drafts and copies; with database each process then\n"
     "has a data folder of its own. Credentials as every S3 program's.",
     "", "data"},
    {"blob-cache", "SIZE", kStore,
     "Of copies in data of what lies in the bucket; the least recently used\n"
     "go first. At least the largest model.",
     "16G"},
    {"s3-insecure", "on|off", kStore, "Plain http to a bucket's store on another machine, too.",
     "off"},
    {"database", "URL", kStore,
     "postgresql://[USER@]HOST[:PORT]/NAME: any number of `strata serve`\n"
     "and `strata worker` share it, and data, which is then a folder they\n"
     "all see; or blobs.",
     "", "SQLite in data, for one process"},
    {"database-password-file", "FILE", kStore,
     "Its first line is the password. Without it libpq's own ways:\n"
     "PGPASSFILE, PGPASSWORD.",
     ""},
    {"lease", "SECONDS", kStore,
     "With database: the jobs of a process that gave no sign of life for so\n"
     "long run elsewhere. 2 to 3600.",
     "30"},
    {"max-attempts", "N", kStore,
     "A job that was begun so often and never ended has failed. 1 to 1000.", "",
     "20, with database 3"},
    {"models", "DIR", kStore, "Meshes to offer, read only, by their names in it. Needs data.", ""},
    {"batches", "DIR", kStore,
     "Where batches over models keep their outputs; with database a folder\n"
     "that all share, or with blobs drafts alone.",
     "", "the folder batches in data"},
    {"model-disk", "SIZE", kStore, "Of uploaded models, unfinished ones included.", "64G"},
    {"result-disk", "SIZE", kStore,
     "Of results; the least recently used of those no job has go first.", "16G"},
    {"stored-jobs", "N", kStore, "Queued in data at a time. 1 to 1000000.", "1000"},
    {"keep-jobs", "HOURS", kStore, "Jobs that ended, and their results. 1 to 100000.", "168"},
    {"scratch", "DIR", kRun, "Meshes and results while their requests last.", "",
     "the system's directory for temporary files"},
    {"log-format", "text|json", kRun, "text or json, to standard error.", "text"},
    {"log-level", "debug|info|warning|error", kRun, "debug, info, warning or error.", "info"},
    {"drain-timeout", "SECONDS", kRun,
     "After SIGTERM or Ctrl-C, for requests in flight to end. 0 to 86400.", "30"},
}};

}  // namespace

std::span<const ServeOption> ServeOptions() { return kOptions; }

bool IsWorkerOption(std::string_view name) {
  constexpr std::array<std::string_view, 24> kNames = {
      "blobs",        "blob-cache", "s3-insecure", "batches",      "http",
      "jobs",         "memory",     "job-memory",  "job-threads",  "job-time",
      "result-size",  "isolate",    "data",        "database",     "lease",
      "max-attempts", "models",     "model-disk",  "result-disk",  "database-password-file",
      "scratch",      "log-format", "log-level",   "drain-timeout"};
  return std::ranges::find(kNames, name) != kNames.end();
}

}  // namespace strata::server
