#include "server/batch/manifest.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <utility>

#include "io/atomic_file.h"
#include "io/output_place.h"
#include "server/batch/names.h"

namespace strata::server {
namespace {

using Json = nlohmann::ordered_json;

tl::unexpected<Error> FailSystem(const std::string& name, int error) {
  return Fail(ErrorCode::kIo, name + ": " + io::SystemReason(error));
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
  json["surface_hash"] = line.surface_hash;
  if (!line.picture.empty()) json["picture"] = line.picture;
}

void GetResult(const Json& json, ManifestLine& line) {
  line.output = GetName(json, "output");
  json.at("output_bytes").get_to(line.output_bytes);
  json.at("output_sha256").get_to(line.output_sha256);
  json.at("samples").get_to(line.samples);
  json.at("cells").get_to(line.cells);
  json.at("edge").get_to(line.edge);
  json.at("triangles").get_to(line.triangles);
  json.at("area").get_to(line.area);
  json.at("skipped").get_to(line.skipped);
  json.at("surface_hash").get_to(line.surface_hash);
  line.picture = json.value("picture", "");
}

ManifestLine LineOf(const Json& json) {
  ManifestLine line;
  line.path = GetName(json, "path");
  line.sampled = json.at("status") == "sampled";
  json.at("input_sha256").get_to(line.input_sha256);
  json.at("input_bytes").get_to(line.input_bytes);
  json.at("stamp").get_to(line.stamp);
  json.at("version").get_to(line.version);
  line.options = json.at("options").dump();
  if (line.sampled) {
    GetResult(json, line);
  } else {
    json.at("error").at("type").get_to(line.error_type);
    json.at("error").at("message").get_to(line.error_message);
  }
  const Json& measured = json.at("measured");
  measured.at("seconds").get_to(line.measured.seconds);
  measured.at("peak_memory_bytes").get_to(line.measured.peak_memory_bytes);
  measured.at("worker").get_to(line.measured.worker);
  measured.at("attempts").get_to(line.measured.attempts);
  measured.at("finished").get_to(line.measured.finished);
  return line;
}

}  // namespace

std::string ToJsonLine(const ManifestLine& line) {
  Json json;
  PutName(json, "path", line.path);
  json["status"] = line.sampled ? "sampled" : "failed";
  json["input_sha256"] = line.input_sha256;
  json["input_bytes"] = line.input_bytes;
  json["stamp"] = line.stamp;
  json["version"] = line.version;
  json["options"] = Json::parse(line.options);
  if (line.sampled) {
    PutResult(line, json);
  } else {
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
  try {
    return LineOf(Json::parse(text));
  } catch (const Json::exception& error) {
    return Fail(ErrorCode::kCorruptInput, std::string("no line of a manifest: ") + error.what());
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
  std::vector<std::string> paths;
  for (const auto& [path, place] : reader_.places_) paths.push_back(path);
  return paths;
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

}  // namespace strata::server
