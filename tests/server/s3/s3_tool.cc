// What the tests of buckets call: one operation of S3Client a run.
#include <fcntl.h>
#include <sys/stat.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "io/fd.h"
#include "server/exit_codes.h"
#include "server/remote/s3_client.h"
#include "server/remote/upload_journal.h"

namespace strata::server {
namespace {

using Arguments = std::vector<std::string>;

void Print(const S3Object& object) {
  std::printf("%s %llu %s\n", PercentEncode(object.key, true).c_str(),
              static_cast<unsigned long long>(object.size), object.etag.c_str());
}

Result<void> Put(S3Client& client, const S3Name& name, const std::string& path) {
  const io::Fd file(open(path.c_str(), O_RDONLY));
  struct stat status {};
  if (!file || fstat(file.get(), &status) != 0) return Fail(ErrorCode::kNotFound, path);
  const auto etag = client.PutFile(name, file.get(), static_cast<std::uint64_t>(status.st_size));
  if (!etag) return Forward(etag);
  std::puts(etag->c_str());
  return {};
}

Result<void> Run(const Arguments& arguments) {
  const std::string& operation = arguments.at(0);
  Result<S3Name> name = ParseS3Url(arguments.at(1));
  if (!name) return Forward(name);
  // Keys that no command line carries: percent-encoded.
  if (const auto key = PercentDecode(name->key); operation.ends_with('%') && key) name->key = *key;
  const Result<S3Config> config = LoadS3Config(std::getenv, false);
  if (!config) return Forward(config);
  std::unique_ptr<UploadJournal> journal;
  if (const char* const path = std::getenv("JOURNAL")) {
    auto opened = UploadJournal::Open(path);
    if (!opened) return Forward(opened);
    journal = std::move(*opened);
  }
  S3Client client(*config, {}, journal.get());
  if (operation.starts_with("list")) {
    return client.List(*name, [](const S3Object& object) {
      Print(object);
      return Result<void>();
    });
  }
  if (operation == "new") {  // URL TEXT
    const auto put = client.PutNew(*name, arguments.at(2));
    if (!put) return Forward(put);
    std::puts(*put ? "put" : "there");
    return {};
  }
  if (operation.starts_with("put")) return Put(client, *name, arguments.at(2));
  if (operation.starts_with("delete")) return client.Delete(*name);
  if (operation.starts_with("get")) {
    const io::Fd file(open(arguments.at(2).c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666));
    const std::uint64_t most = arguments.size() > 3 ? std::stoull(arguments[3]) : UINT64_MAX;
    const Result<S3Object> object = client.GetToFile(*name, file.get(), most);
    if (!object) return Forward(object);
    Print(*object);
    return {};
  }
  if (operation == "read") {  // URL OFFSET COUNT [ETAG]
    std::string bytes(std::stoull(arguments.at(3)), 0);
    const std::string etag = arguments.size() > 4 ? arguments[4] : "";
    auto read = client.ReadAt(*name, std::stoull(arguments.at(2)), bytes, etag);
    if (read) std::fwrite(bytes.data(), 1, bytes.size(), stdout);
    return read;
  }
  if (operation.starts_with("head")) {
    const Result<S3Object> object = client.Head(*name);
    if (!object) return Forward(object);
    Print(*object);
    return {};
  }
  const Result<int> aborted =
      operation == "leftovers"
          ? journal->AbortLeftovers(client)
          : client.AbortStaleUploads(*name, std::chrono::seconds(std::stoll(arguments.at(2))));
  if (!aborted) return Forward(aborted);
  std::printf("%d\n", *aborted);
  return {};
}

}  // namespace
}  // namespace strata::server

int main(int argc, char** argv) {
  const auto outcome = strata::server::Run({argv + 1, argv + argc});
  if (outcome) return 0;
  std::fprintf(stderr, "%s\n", outcome.error().message.c_str());
  return strata::server::ExitCodeOf(outcome.error().code).exit_status;
}
