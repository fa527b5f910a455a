#include "server/batch/report.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <utility>

#include "core/version.h"
#include "server/batch/names.h"
#include "server/batch/report_page.h"
#include "server/batch/report_places.h"
#include "server/human_units.h"

namespace strata::server {
namespace {

using Json = nlohmann::ordered_json;

Result<std::vector<std::string>> ManifestsIn(const std::string& folder) {
  std::vector<std::string> names;
  std::error_code failed;
  for (std::filesystem::directory_iterator at(folder, failed), end; !failed && at != end;
       at.increment(failed)) {
    const std::string name = at->path().filename().string();
    if (name.starts_with("manifest") && name.ends_with(".jsonl")) {
      names.push_back(at->path().string());
    }
  }
  if (failed) return Fail(ErrorCode::kNotFound, folder + ": " + failed.message());
  if (names.empty()) {
    return Fail(ErrorCode::kNotFound,
                folder + ": found no manifest, expected the folder of a batch's outputs");
  }
  std::ranges::sort(names);
  return names;
}

void Count(const ManifestLine& line, Report& report) {
  ++(line.sampled ? report.sampled : report.failed);
  if (!line.sampled) ++report.reasons[line.error_type];
  report.samples += line.samples;
  report.triangles += line.triangles;
  for (const auto& [reason, count] : line.skipped) report.skipped += count;
  report.left_out += line.left_out.size();
  report.input_bytes += line.input_bytes;
  report.output_bytes += line.output_bytes;
  report.area += line.area;
  report.seconds += line.measured.seconds;
  report.peak_memory_bytes = std::max(report.peak_memory_bytes, line.measured.peak_memory_bytes);
}

Json NamedSeconds(const ReportRow& row) {
  Json json;
  PutName(json, "path", row.line.path);
  json["seconds"] = row.line.measured.seconds;
  json["samples"] = row.line.samples;
  return json;
}

Json Failure(const ReportRow& row) {
  Json json;
  PutName(json, "path", row.line.path);
  json["type"] = row.line.error_type;
  json["message"] = row.line.error_message;
  return json;
}

const ReportRow* FirstOf(const Report& report, const std::string& reason) {
  const auto found = std::ranges::find_if(report.rows, [&](const ReportRow& row) {
    return !row.line.sampled && row.line.error_type == reason;
  });
  return &*found;
}

std::string Bytes(std::uint64_t bytes) { return Si(static_cast<double>(bytes)) + 'B'; }

}  // namespace

std::vector<const ReportRow*> Report::Slowest(std::size_t count) const {
  std::vector<const ReportRow*> all;
  for (const ReportRow& row : rows) all.push_back(&row);
  count = std::min(count, all.size());
  const auto slower = [](const ReportRow* a, const ReportRow* b) {
    return a->line.measured.seconds > b->line.measured.seconds;
  };
  std::partial_sort(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(count), all.end(),
                    slower);
  all.resize(count);
  return all;
}

Result<Report> ReadReport(const std::vector<std::string>& folders) {
  Report report;
  report.folders = folders;
  std::map<std::string, ReportRow> rows;
  for (const std::string& folder : folders) {
    const auto names = ManifestsIn(folder);
    if (!names) return Forward(names);
    for (const std::string& name : *names) {
      const auto reader = ManifestReader::Open(name);
      if (!reader) return Forward(reader);
      auto read = reader->ForEach([&](ManifestLine&& line) -> Result<void> {
        ReportRow& row = rows[line.path];
        // Instants of one form: their order is that of their texts.
        const bool newer =
            row.folder.empty() || row.line.measured.finished < line.measured.finished;
        if (newer) row = {std::move(line), folder};
        return {};
      });
      if (!read) return Forward(read);
    }
  }
  for (auto& [path, row] : rows) {
    if (row.line.gone) continue;
    Count(row.line, report);
    report.rows.push_back(std::move(row));
  }
  return report;
}

std::string ReportText(const Report& report, std::size_t slowest) {
  std::ostringstream out;
  out << "models     " << Grouped(report.rows.size()) << ": " << Grouped(report.sampled)
      << " sampled, " << Grouped(report.failed) << " failed\nsamples    " << Grouped(report.samples)
      << "\ntriangles  " << Grouped(report.triangles) << ", skipped " << Grouped(report.skipped)
      << "\narea       " << Short(report.area) << "\nbytes      " << Bytes(report.input_bytes)
      << " read, " << Bytes(report.output_bytes) << " written\ntime       "
      << Seconds(report.seconds) << " of all models\nmemory     " << Bytes(report.peak_memory_bytes)
      << " at most in one worker\n";
  if (report.left_out != 0) {
    out << "left out   " << Grouped(report.left_out)
        << " attributes that are missing or damaged (left_out in the manifest)\n";
  }
  if (!report.reasons.empty()) out << "\nfailures\n";
  for (const auto& [reason, count] : report.reasons) {
    const ReportRow* const first = FirstOf(report, reason);
    out << "  " << Grouped(count) << "  " << reason << ": " << Printable(first->line.path) << ": "
        << Printable(WithoutPath(first->line.error_message, first->line.path)) << '\n';
  }
  const auto rows = report.Slowest(slowest);
  if (!rows.empty()) out << "\nslowest\n";
  for (const ReportRow* const row : rows) {
    out << "  " << Seconds(row->line.measured.seconds) << "  " << Printable(row->line.path) << '\n';
  }
  return out.str();
}

std::string ReportJson(const Report& report, std::size_t slowest) {
  Json json = {{"program", "strata"},
               {"version", kVersion},
               {"models", report.rows.size()},
               {"sampled", report.sampled},
               {"failed", report.failed},
               {"samples", report.samples},
               {"triangles", report.triangles},
               {"skipped_triangles", report.skipped},
               {"left_out", report.left_out},
               {"area", report.area},
               {"input_bytes", report.input_bytes},
               {"output_bytes", report.output_bytes},
               {"seconds", report.seconds},
               {"peak_memory_bytes", report.peak_memory_bytes},
               {"reasons", report.reasons},
               {"slowest", Json::array()},
               {"failures", Json::array()}};
  for (const ReportRow* const row : report.Slowest(slowest)) {
    json["slowest"].push_back(NamedSeconds(*row));
  }
  for (const ReportRow& row : report.rows) {
    if (!row.line.sampled) json["failures"].push_back(Failure(row));
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + '\n';
}

Result<void> RunReport(const ReportCommand& command) {
  auto places = ReportPlaces::Open(command);
  if (!places) return Forward(places);
  auto report = ReadReport(places->folders());
  if (!report) return Forward(report);
  report->folders = command.outputs;
  if (command.html) {
    if (auto written = places->WritePage(*command.html, ReportPage(*report)); !written) {
      return written;
    }
  }
  std::string text =
      command.json ? ReportJson(*report, command.slowest) : ReportText(*report, command.slowest);
  if (command.html) text += "\npage       " + *command.html + '\n';
  if (std::fputs(text.c_str(), stdout) < 0 || std::fflush(stdout) != 0) {
    return Fail(ErrorCode::kIo, "cannot write to standard output");
  }
  return {};
}

}  // namespace strata::server
