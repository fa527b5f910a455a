#include "server/batch/batch_progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <sstream>
#include <string_view>

#include "server/batch/names.h"
#include "server/human_units.h"

namespace strata::server {
namespace {

bool IsTerminal(int fd) {
  const char* const kind = std::getenv("TERM");
  return kind && std::string_view(kind) != "dumb" && isatty(fd) == 1;
}

void Write(int fd, const std::string& text) {
  [[maybe_unused]] const ssize_t written = write(fd, text.data(), text.size());
}

std::string ReasonsText(const BatchTally& tally) {
  std::string text;
  for (const auto& [reason, count] : tally.reasons) {
    text += (text.empty() ? " (" : ", ") + reason + ' ' + Grouped(count);
  }
  return text.empty() ? text : text + ')';
}

}  // namespace

std::string BatchProgressLine(const BatchTally& tally, double seconds, double cost_done,
                              double cost) {
  std::ostringstream line;
  line << Grouped(tally.done()) << " of " << Grouped(tally.models) << " models";
  const double worked = static_cast<double>(tally.sampled + tally.failed);
  if (worked > 0 && seconds > 0) line << ", " << Short(worked / seconds, 3) << " models/s";
  if (cost_done > 0 && cost_done < cost) {
    line << ", " << Seconds(seconds * (cost - cost_done) / cost_done) << " left";
  }
  line << ", " << Grouped(tally.all_failed()) << " failed";
  return line.str();
}

std::string BatchProgressJson(const BatchTally& tally, double seconds, double cost_done,
                              double cost) {
  nlohmann::ordered_json json = {{"models", tally.models},     {"sampled", tally.sampled},
                                 {"unchanged", tally.skipped}, {"failed", tally.all_failed()},
                                 {"samples", tally.samples},   {"seconds", seconds}};
  if (cost_done > 0) json["seconds_left"] = seconds * std::max(0.0, cost - cost_done) / cost_done;
  return json.dump() + '\n';
}

std::string BatchSummary(const BatchTally& tally, double seconds) {
  std::ostringstream out;
  out << "models     " << Grouped(tally.models) << ": " << Grouped(tally.sampled) << " sampled, "
      << Grouped(tally.skipped) << " unchanged, " << Grouped(tally.all_failed()) << " failed"
      << ReasonsText(tally);
  if (tally.kept_failed > 0) out << ", " << Grouped(tally.kept_failed) << " of them before";
  out << "\nsamples    " << Grouped(tally.samples) << "\ntime       " << Seconds(seconds);
  if (tally.sampled > 0 && seconds > 0) {
    out << ", " << Short(static_cast<double>(tally.sampled) / seconds, 3) << " models/s";
  }
  if (tally.retried > 0) out << "\nretried    " << Grouped(tally.retried);
  if (tally.pruned > 0) out << "\npruned     " << Grouped(tally.pruned) << " outputs";
  out << '\n';
  return out.str();
}

BatchProgress::BatchProgress(bool quiet, std::chrono::seconds interval, int fd)
    : quiet_(quiet), terminal_(!quiet && IsTerminal(fd)), interval_(interval), fd_(fd) {}

void BatchProgress::Begin(const BatchTally& tally, double cost) {
  const std::lock_guard lock(mutex_);
  tally_ = tally;
  cost_ = cost;
}

void BatchProgress::Add(End end, double cost, std::uint64_t samples, const std::string& path,
                        const std::string& reason, const std::string& message) {
  const std::lock_guard lock(mutex_);
  cost_done_ += cost;
  tally_.samples += samples;
  if (end == End::kSampled) ++tally_.sampled;
  if (end == End::kSkipped) ++tally_.skipped;
  if (end == End::kSampled || end == End::kSkipped) return;
  ++tally_.reasons[reason];
  ++(end == End::kFailed ? tally_.failed : tally_.kept_failed);
  if (end == End::kFailedBefore) return;
  Say("strata: " + Printable(path) + ": failed: " + reason + ": " +
      Printable(WithoutPath(message, path)));
}

void BatchProgress::AddRetry(const std::string& path, const std::string& message) {
  const std::lock_guard lock(mutex_);
  ++tally_.retried;
  if (!quiet_)
    Say("strata: " + Printable(path) +
        ": is tried again: " + Printable(WithoutPath(message, path)));
}

void BatchProgress::SetPruned(std::uint64_t count) {
  const std::lock_guard lock(mutex_);
  tally_.pruned = count;
}

void BatchProgress::Say(const std::string& line) {
  Write(fd_, (terminal_ ? "\r" + line + "\x1b[K\n" : line + '\n'));
}

void BatchProgress::Tick() {
  const std::lock_guard lock(mutex_);
  if (quiet_) return;
  const double now = watch_.seconds();
  if (!terminal_ && now - said_at_ < static_cast<double>(interval_.count())) return;
  said_at_ = now;
  const std::string line = BatchProgressLine(tally_, now, cost_done_, cost_);
  Write(fd_, terminal_ ? '\r' + line.substr(0, 79) + "\x1b[K" : "strata: " + line + '\n');
}

void BatchProgress::Stop() {
  const std::lock_guard lock(mutex_);
  if (terminal_) Write(fd_, "\r\x1b[K");
}

std::string BatchProgress::Json() const {
  const std::lock_guard lock(mutex_);
  return BatchProgressJson(tally_, watch_.seconds(), cost_done_, cost_);
}

BatchTally BatchProgress::tally() const {
  const std::lock_guard lock(mutex_);
  return tally_;
}

}  // namespace strata::server
