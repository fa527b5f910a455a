#include "server/batch/manifest.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <utility>

#include "core/signal_shield.h"
#include "io/atomic_file.h"
#include "io/output_place.h"
#include "io/sample_writer.h"
#include "server/batch/bucket_output.h"
#include "server/batch/names.h"
#include "server/batch/places.h"

namespace strata::server {
namespace {

using Json = nlohmann::ordered_json;

tl::unexpected<Error> FailSystem(const std::string& name, int error) {
  return Fail(ErrorCode::kIo, name + ": " + io::SystemReason(error));
}

void PutCompanions(const std::vector<CompanionEntry>& companions, Json& json) {
  for (const CompanionEntry& each : companions) {
    Json entry;
    PutName(entry, "path", each.path);
    if (!each.stamp.empty()) {
      entry["bytes"] = each.size;
      entry["stamp"] = each.stamp;
    }
    json["companions"].push_back(std::move(entry));
  }
}

void PutResult(const ManifestLine& line, Json& json) {
  PutName(json, "output", line.output);
  json["output_bytes"] = line.output_bytes;
  json["output_sha256"] = line.output_sha256;
  json["samples"] = line.samples;
  json["cells"] = line.cells;
  json["edge"] = line.edge;
  json["triangles"] = line.triangles;
  json["area"] = line.area;
  json["skipped"] = line.skipped;
  if (!line.left_out.empty()) json["left_out"] = line.left_out;
  json["surface_hash"] = line.surface_hash;
  if (!line.picture.empty()) json["picture"] = line.picture;
}

// --- Lines from outside: a manifest lies beside outputs, where others may write ------------------

/// What a line says that no batch writes.
struct NotOurs {
  std::string why;
};

/// A whole number that fits: the library's own conversions are not defined for others.
std::uint64_t Count(const Json& json, const char* key) {
  const Json& value = json.at(key);
  if (!value.is_number_unsigned()) throw NotOurs{std::string(key) + " is no whole number"};
  return value.get<std::uint64_t>();
}

double Measure(const Json& json, const char* key) {
  const Json& value = json.at(key);
  if (!value.is_number()) throw NotOurs{std::string(key) + " is no number"};
  return value.get<double>();
}

/// How deep the brackets of a JSON text go: what writes it anew calls itself for each of them.
std::size_t DepthOf(std::string_view text) {
  std::size_t depth = 0, most = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') quoted = !quoted;
    if (quoted && c == '\\') ++i;
    if (quoted) continue;
    if (c == '{' || c == '[') most = std::max(most, ++depth);
    if ((c == '}' || c == ']') && depth > 0) --depth;
  }
  return most;
}

/// Outputs are replaced and removed by the names that stand here: only such as a batch gives.
void CheckNames(const ManifestLine& line) {
  if (!IsModelPath(line.path)) throw NotOurs{"path is none below a folder"};
  if (!line.sampled) return;
  const std::string start = line.path + '.';
  const bool of_path = line.output.starts_with(start) &&
                       line.output.find_first_of("./", start.size()) == line.output.npos &&
                       io::SampleFormatFromPath(line.output).has_value();
  if (!of_path) throw NotOurs{"output is not the path with the suffix of a format"};
  if (!line.picture.empty() && !IsBatchPicture(line.picture)) {
    throw NotOurs{"picture is not the name of one"};
  }
}

void GetCompanions(const Json& json, std::vector<CompanionEntry>& companions) {
  for (const Json& each : json) {
    CompanionEntry& entry = companions.emplace_back();
    entry.path = GetName(each, "path");
    if (!IsModelPath(entry.path)) throw NotOurs{"companion is none below the model's folder"};
    if (!each.contains("stamp")) continue;
    entry.size = Count(each, "bytes");
    each.at("stamp").get_to(entry.stamp);
  }
}

void GetResult(const Json& json, ManifestLine& line) {
  line.output = GetName(json, "output");
  line.output_bytes = Count(json, "output_bytes");
  json.at("output_sha256").get_to(line.output_sha256);
  line.samples = Count(json, "samples");
  line.cells = Count(json, "cells");
  line.edge = Measure(json, "edge");
  line.triangles = Count(json, "triangles");
  line.area = Measure(json, "area");
  for (const auto& [reason, count] : json.at("skipped").items()) {
    line.skipped[reason] = Count(json.at("skipped"), reason.c_str());
  }
  if (json.contains("left_out")) json.at("left_out").get_to(line.left_out);
  json.at("surface_hash").get_to(line.surface_hash);
  line.picture = json.value("picture", "");
}

void GetMeasured(const Json& json, ManifestLine::Measured& measured) {
  measured.seconds = Measure(json, "seconds");
  measured.peak_memory_bytes = Count(json, "peak_memory_bytes");
  measured.worker = static_cast<std::int64_t>(Count(json, "worker"));
  measured.attempts = static_cast<int>(std::min<std::uint64_t>(Count(json, "attempts"), 1000));
  json.at("finished").get_to(measured.finished);
}

ManifestLine LineOf(const Json& json) {
  ManifestLine line;
  line.path = GetName(json, "path");
  line.sampled = json.at("status") == "sampled";
  line.gone = json.at("status") == "gone";
  GetMeasured(json.at("measured"), line.measured);
  if (!line.gone) {
    json.at("input_sha256").get_to(line.input_sha256);
    line.input_bytes = Count(json, "input_bytes");
    json.at("stamp").get_to(line.stamp);
    if (json.contains("companions")) GetCompanions(json.at("companions"), line.companions);
    json.at("version").get_to(line.version);
    line.options = json.at("options").dump();
  }
  if (line.sampled) {
    GetResult(json, line);
  } else if (!line.gone) {
    json.at("error").at("type").get_to(line.error_type);
    json.at("error").at("message").get_to(line.error_message);
  }
  CheckNames(line);
  return line;
}

}  // namespace

std::string InstantNow() {
  const auto now = std::chrono::system_clock::now().time_since_epoch();
  const auto millis = std::chrono::duration_cast<std::chrono::milliseconds>(now).count();
  const std::time_t seconds = millis / 1000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[96];
  std::snprintf(text, sizeof text, "%04d-%02d-%02dT%02d:%02d:%02d.%03dZ", utc.tm_year + 1900,
                utc.tm_mon + 1, utc.tm_mday, utc.tm_hour, utc.tm_min, utc.tm_sec,
                static_cast<int>(millis % 1000));
  return text;
}

std::string ToJsonLine(const ManifestLine& line) {
  Json json;
  PutName(json, "path", line.path);
  json["status"] = line.gone ? "gone" : line.sampled ? "sampled" : "failed";
  if (!line.gone) {
    json["input_sha256"] = line.input_sha256;
    json["input_bytes"] = line.input_bytes;
    json["stamp"] = line.stamp;
    PutCompanions(line.companions, json);
    json["version"] = line.version;
    json["options"] = Json::parse(line.options);
  }
  if (line.sampled) {
    PutResult(line, json);
  } else if (!line.gone) {
    json["error"] = {{"type", line.error_type}, {"message", AsUtf8(line.error_message)}};
  }
  json["measured"] = {{"seconds", line.measured.seconds},
                      {"peak_memory_bytes", line.measured.peak_memory_bytes},
                      {"worker", line.measured.worker},
                      {"attempts", line.measured.attempts},
                      {"finished", line.measured.finished}};
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Result<ManifestLine> FromJsonLine(std::string_view text) {
  constexpr std::size_t kMostDepth = 32;
  try {
    if (DepthOf(text) > kMostDepth) throw NotOurs{"brackets in brackets without end"};
    return LineOf(Json::parse(text));
  } catch (const Json::exception& error) {
    return Fail(ErrorCode::kCorruptInput, std::string("no line of a manifest: ") + error.what());
  } catch (const NotOurs& fault) {
    return Fail(ErrorCode::kCorruptInput, "no line of a manifest: " + fault.why);
  }
}

// --- Reading -------------------------------------------------------------------------------------

Result<ManifestReader> ManifestReader::Open(const std::string& path) {
  ManifestReader reader;
  reader.name_ = path;
  reader.file_ = io::Fd(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!reader.file_ && errno == ENOENT) return reader;
  if (!reader.file_) return FailSystem(path, errno);
  if (auto scanned = reader.Scan(); !scanned) return Forward(scanned);
  return reader;
}

Result<void> ManifestReader::Scan() {
  std::string text;
  std::vector<char> block(std::size_t{1} << 20);
  std::uint64_t number = 0;
  std::optional<Error> fault;  // Of the last line: only a line after it makes it one.
  while (true) {
    const ssize_t n = read(file_.get(), block.data(), block.size());
    if (n < 0) return FailSystem(name_, errno);
    if (n == 0) return {};
    text.append(block.data(), static_cast<std::size_t>(n));
    std::size_t begin = 0;
    for (std::size_t end; (end = text.find('\n', begin)) != text.npos; begin = end + 1) {
      if (fault) return tl::unexpected<Error>(*fault);
      ++number;
      const auto line = FromJsonLine(std::string_view(text).substr(begin, end - begin));
      if (!line) {
        fault = Error{ErrorCode::kCorruptInput,
                      name_ + ", line " + std::to_string(number) + ": " + line.error().message};
        continue;
      }
      places_[line->path] = {end_, static_cast<std::uint32_t>(end - begin)};
      end_ += end - begin + 1;
    }
    text.erase(0, begin);
  }
}

Result<std::string> ManifestReader::Read(const Place& place) const {
  std::string text(place.bytes, '\0');
  const ssize_t n = pread(file_.get(), text.data(), text.size(), static_cast<off_t>(place.offset));
  if (n < 0) return FailSystem(name_, errno);
  if (static_cast<std::size_t>(n) != text.size()) {
    return Fail(ErrorCode::kIo, name_ + ": became shorter while it was read");
  }
  return text;
}

Result<std::optional<ManifestLine>> ManifestReader::Find(const std::string& path) const {
  const auto found = places_.find(path);
  if (found == places_.end()) return std::optional<ManifestLine>();
  const auto text = Read(found->second);
  if (!text) return Forward(text);
  auto line = FromJsonLine(*text);
  if (!line) return Forward(line);
  return std::optional(*std::move(line));
}

std::vector<std::string> ManifestReader::Paths() const {
  std::vector<std::string> paths;
  for (const auto& [path, place] : places_) paths.push_back(path);
  return paths;
}

Result<void> ManifestReader::ForEach(
    const std::function<Result<void>(ManifestLine&&)>& take) const {
  for (const auto& [path, place] : places_) {
    const auto text = Read(place);
    if (!text) return Forward(text);
    auto line = FromJsonLine(*text);
    if (!line) return Forward(line);
    if (auto taken = take(*std::move(line)); !taken) return taken;
  }
  return {};
}

// --- Writing -------------------------------------------------------------------------------------

Result<std::unique_ptr<Manifest>> Manifest::Open(const std::string& path) {
  auto reader = ManifestReader::Open(path);
  if (!reader) return Forward(reader);
  const bool is_new = !reader->file_;
  reader->file_ = io::Fd(open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0666));
  if (!reader->file_) return FailSystem(path, errno);
  // What a killed writer left of a line.
  if (ftruncate(reader->file_.get(), static_cast<off_t>(reader->end_)) != 0) {
    return FailSystem(path, errno);
  }
  if (is_new) static_cast<void>(io::SyncFolder(AT_FDCWD, io::FolderOf(path).c_str()));
  auto manifest = std::unique_ptr<Manifest>(new Manifest(*std::move(reader)));
  manifest->syncer_ = std::thread([raw = manifest.get()] { raw->SyncNowAndThen(); });
  return manifest;
}

Manifest::~Manifest() {
  {
    const std::lock_guard lock(mutex_);
    stopped_ = true;
  }
  wake_.notify_one();
  if (syncer_.joinable()) syncer_.join();
}

void Manifest::SyncNowAndThen() {
  std::unique_lock lock(mutex_);
  while (true) {
    wake_.wait(lock, [this] { return written_ || stopped_; });
    if (!written_) return;
    written_ = false;
    const io::Fd file(fcntl(reader_.file_.get(), F_DUPFD_CLOEXEC, 0));
    lock.unlock();  // Lines that come meanwhile are the next round's.
    fdatasync(file.get());
    lock.lock();
  }
}

Result<void> Manifest::Append(const ManifestLine& line) {
  const std::string text = ToJsonLine(line) + '\n';
  const std::lock_guard lock(mutex_);
  const SignalShield shield({SIGXFSZ});  // A limit of files' sizes is an error here, not an end.
  std::size_t done = 0;
  while (done < text.size()) {
    const ssize_t n = pwrite(reader_.file_.get(), text.data() + done, text.size() - done,
                             static_cast<off_t>(reader_.end_ + done));
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) {
      const int error = n < 0 ? errno : ENOSPC;
      if (ftruncate(reader_.file_.get(), static_cast<off_t>(reader_.end_)) != 0) {
        return FailSystem(reader_.name_, errno);
      }
      return FailSystem(reader_.name_, error);
    }
    done += static_cast<std::size_t>(n);
  }
  reader_.places_[line.path] = {reader_.end_, static_cast<std::uint32_t>(text.size() - 1)};
  reader_.end_ += text.size();
  written_ = true;
  wake_.notify_one();
  return {};
}

Result<std::optional<ManifestLine>> Manifest::Find(const std::string& path) const {
  const std::lock_guard lock(mutex_);
  return reader_.Find(path);
}

std::vector<std::string> Manifest::Paths() const {
  const std::lock_guard lock(mutex_);
  return reader_.Paths();
}

void Manifest::Forget(const std::string& path) {
  const std::lock_guard lock(mutex_);
  reader_.places_.erase(path);
}

Result<void> Manifest::Rewrite() {
  const std::lock_guard lock(mutex_);
  auto file = io::AtomicFile::Open(reader_.name_);
  if (!file) return Forward(file);
  std::uint64_t offset = 0;
  std::map<std::string, ManifestReader::Place> places;
  for (const auto& [path, place] : reader_.places_) {
    auto text = reader_.Read(place);
    if (!text) return Forward(text);
    places[path] = {offset, place.bytes};
    offset += place.bytes + 1;
    if (auto written = (*file)->Write(*text + '\n'); !written) return written;
  }
  if (auto bytes = (*file)->Finish(); !bytes) return Forward(bytes);
  reader_.file_ = io::Fd(open(reader_.name_.c_str(), O_RDWR | O_CLOEXEC));
  if (!reader_.file_) return FailSystem(reader_.name_, errno);
  reader_.places_ = std::move(places);
  reader_.end_ = offset;
  return {};
}

Result<std::uint64_t> EndOfLines(
    const std::function<Result<void>(std::uint64_t offset, std::span<char> out)>& read,
    std::uint64_t size) {
  std::array<char, 4096> block;
  while (size > 0) {
    const std::size_t n = std::min<std::uint64_t>(size, block.size());
    if (auto done = read(size - n, {block.data(), n}); !done) return Forward(done);
    const std::string_view text(block.data(), n);
    if (const auto at = text.rfind('\n'); at != text.npos) return size - n + at + 1;
    size -= n;
  }
  return 0;
}

}  // namespace strata::server
