// Where a report reads manifests from and its page goes: folders, buckets.
#pragma once

#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/batch/batch_config.h"

namespace strata::server {

/// Folders with the manifests and pictures of the places that a report names: of a bucket's, a copy
/// in a temporary folder, as long as this lives.
class ReportPlaces {
 public:
  /// Errors: those of the buckets; kIo.
  static Result<ReportPlaces> Open(const ReportCommand& command);
  ReportPlaces(ReportPlaces&&) noexcept;
  ReportPlaces& operator=(ReportPlaces&&) noexcept;
  ~ReportPlaces();

  /// One for each of ReportCommand::outputs.
  const std::vector<std::string>& folders() const { return folders_; }
  /// To a file or an object, whole or not at all. Errors: kIo.
  Result<void> WritePage(const std::string& place, std::string_view page);

 private:
  class Buckets;
  ReportPlaces();
  std::unique_ptr<Buckets> buckets_;  // Null: none.
  std::vector<std::string> folders_;
};

}  // namespace strata::server
