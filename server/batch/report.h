// What batches came to: their manifests, merged and counted.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/batch/batch_config.h"
#include "server/batch/manifest.h"

namespace strata::server {

/// One model of a report.
struct ReportRow {
  ManifestLine line;
  std::string folder;  ///< The folder of outputs whose manifest holds the line.
};

/// All models of some folders, in order of their paths' bytes. A model that several manifests hold
/// counts once, as the one finished last.
struct Report {
  std::vector<std::string> folders;
  std::vector<ReportRow> rows;
  std::uint64_t sampled = 0, failed = 0;
  std::uint64_t samples = 0, triangles = 0, skipped = 0, left_out = 0, input_bytes = 0,
                output_bytes = 0;
  double area = 0, seconds = 0;
  std::uint64_t peak_memory_bytes = 0;
  std::map<std::string, std::uint64_t> reasons;  ///< Of the failed, by type.

  /// The `count` that took longest, the longest first.
  std::vector<const ReportRow*> Slowest(std::size_t count) const;
};

/// Reads every manifest*.jsonl in the folders. Memory: about 1 KiB a model.
/// Errors: kNotFound for a folder without a manifest, kIo, kCorruptInput.
Result<Report> ReadReport(const std::vector<std::string>& folders);

/// For a terminal; several lines.
std::string ReportText(const Report& report, std::size_t slowest);
/// For programs, indented, with a line end.
std::string ReportJson(const Report& report, std::size_t slowest);

/// `strata report`: prints, and writes the page. Errors: those of ReadReport, kIo.
Result<void> RunReport(const ReportCommand& command);

}  // namespace strata::server
