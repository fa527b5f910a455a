#include "server/batch/report_places.h"

#include <fcntl.h>
#include <stdlib.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <utility>

#include "io/atomic_file.h"
#include "io/fd.h"
#include "io/output_place.h"
#include "server/batch/bucket_output.h"
#include "server/remote/s3_client.h"

namespace strata::server {

namespace fs = std::filesystem;

/// The store, and the folder of the copies.
class ReportPlaces::Buckets {
 public:
  Buckets(S3Config config, std::string folder)
      : client_(std::move(config)), folder_(std::move(folder)) {}
  ~Buckets() {
    std::error_code ignored;
    fs::remove_all(folder_, ignored);
  }

  static Result<std::unique_ptr<Buckets>> Open(bool insecure) {
    Result<S3Config> config = LoadS3Config(std::getenv, insecure);
    if (!config) return Forward(config);
    std::error_code failed;
    std::string folder = (fs::temp_directory_path(failed) / "strata-report-XXXXXX").string();
    if (mkdtemp(folder.data()) == nullptr) {
      return Fail(ErrorCode::kIo, folder + ": cannot make it: " + io::SystemReason(errno));
    }
    return std::make_unique<Buckets>(std::move(*config), std::move(folder));
  }

  /// Copies what a report reads into a folder of its own.
  Result<std::string> Copy(const std::string& url, std::size_t index) {
    const Result<S3Name> prefix = ParseS3Folder(url);
    if (!prefix) return Forward(prefix);
    std::string folder = folder_ + '/' + std::to_string(index);
    std::error_code failed;
    fs::create_directories(folder + "/.strata/pictures", failed);
    const Result<void> copied = client_.List(*prefix, [&](const S3Object& object) {
      const std::string name = object.key.substr(prefix->key.size());
      return IsBatchManifest(name) || IsBatchPicture(name)
                 ? Fetch({prefix->bucket, object.key}, folder + '/' + name)
                 : Result<void>();
    });
    if (!copied) return Forward(copied);
    return folder;
  }

  Result<void> Put(const std::string& url, std::string_view bytes) {
    const Result<S3Name> name = ParseS3Url(url);
    if (!name) return Forward(name);
    const Result<std::string> etag = client_.Put(*name, bytes);
    return etag ? Result<void>() : Forward(etag);
  }

 private:
  Result<void> Fetch(const S3Name& name, const std::string& path) {
    const io::Fd file(open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600));
    if (!file) return Fail(ErrorCode::kIo, path + ": " + io::SystemReason(errno));
    const Result<S3Object> object = client_.GetToFile(name, file.get());
    return object ? Result<void>() : Forward(object);
  }

  S3Client client_;
  const std::string folder_;
};

ReportPlaces::ReportPlaces() = default;
ReportPlaces::ReportPlaces(ReportPlaces&&) noexcept = default;
ReportPlaces& ReportPlaces::operator=(ReportPlaces&&) noexcept = default;
ReportPlaces::~ReportPlaces() = default;

Result<ReportPlaces> ReportPlaces::Open(const ReportCommand& command) {
  ReportPlaces places;
  if (std::ranges::any_of(command.outputs, IsS3Url) || IsS3Url(command.html.value_or(""))) {
    Result<std::unique_ptr<Buckets>> buckets = Buckets::Open(command.s3_insecure);
    if (!buckets) return Forward(buckets);
    places.buckets_ = std::move(*buckets);
  }
  for (std::size_t i = 0; i < command.outputs.size(); ++i) {
    const std::string& output = command.outputs[i];
    Result<std::string> folder =
        IsS3Url(output) ? places.buckets_->Copy(output, i) : Result<std::string>(output);
    if (!folder) return Forward(folder);
    places.folders_.push_back(std::move(*folder));
  }
  return places;
}

Result<void> ReportPlaces::WritePage(const std::string& place, std::string_view page) {
  if (IsS3Url(place)) return buckets_->Put(place, page);
  auto file = io::AtomicFile::Open(place);
  if (!file) return Forward(file);
  if (auto written = (*file)->Write(page); !written) return written;
  const auto bytes = (*file)->Finish();
  return bytes ? Result<void>() : Forward(bytes);
}

}  // namespace strata::server
