#include "server/store/membership.h"

#include <unistd.h>

#include <array>

#include "server/store/file.h"

namespace strata::server {
namespace {

constexpr std::size_t kIdDigits = 32;

}  // namespace

std::string ProcessName() {
  std::array<char, 256> host{};
  if (gethostname(host.data(), host.size() - 1) != 0) host[0] = 0;
  return std::string(host.data()) + ":" + std::to_string(getpid());
}

Result<std::unique_ptr<Membership>> Membership::Join(Database& database, Milliseconds lease) {
  std::unique_ptr<Membership> membership(new Membership(database, lease));
  if (!database.shared()) return membership;
  if (auto entered = membership->Enter(); !entered) return Forward(entered);
  return membership;
}

Membership::~Membership() {
  const std::string mine = id();
  if (mine.empty()) return;
  // Where this fails the lease runs out.
  (void)database_.Read().Run("DELETE FROM processes WHERE id = ?", mine);
}

Result<void> Membership::Enter() {
  const std::string fresh = RandomId();
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  const auto now = session->Now();
  if (!now) return Forward(now);
  auto entered =
      session->Run("INSERT INTO processes (id, name, started, lease_until) VALUES (?, ?, ?, ?)",
                   fresh, ProcessName(), ToMillis(*now), ToMillis(*now + lease_));
  if (!entered) return Forward(entered);
  if (auto committed = session->Commit(); !committed) return committed;
  const std::lock_guard lock(mutex_);
  id_ = fresh;
  return {};
}

std::string Membership::id() const {
  const std::lock_guard lock(mutex_);
  return id_;
}

std::string Membership::NewName() {
  const std::string mine = id();
  return mine.empty() ? RandomId() : mine + '.' + std::to_string(++names_);
}

Result<void> Membership::Renew() {
  if (!shared()) return {};
  {
    auto session = database_.WriteRows();
    if (!session) return Forward(session);
    const auto now = session->Now();
    if (!now) return Forward(now);
    auto renewed = session->Run("UPDATE processes SET lease_until = ? WHERE id = ?",
                                ToMillis(*now + lease_), id());
    if (!renewed) return Forward(renewed);
    if (auto committed = session->Commit(); !committed) return committed;
    if (*renewed == 1) return {};
  }
  return Enter();
}

Result<std::size_t> Membership::ExpireOthers() {
  if (!shared()) return 0;
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  const auto now = session->Now();
  if (!now) return Forward(now);
  auto expired = session->Run("DELETE FROM processes WHERE lease_until <= ?", ToMillis(*now));
  if (!expired) return Forward(expired);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return static_cast<std::size_t>(*expired);
}

Result<std::vector<std::string>> Membership::Living() {
  std::vector<std::string> ids;
  auto listed = database_.Read().Query("SELECT id FROM processes",
                                       [&](const Row& row) { ids.push_back(row.Text(0)); });
  if (!listed) return Forward(listed);
  return ids;
}

std::string_view MakerOf(std::string_view file_name) {
  const std::string_view id = file_name.substr(0, kIdDigits);
  const bool ours =
      file_name.size() > kIdDigits && file_name[kIdDigits] == '.' && IsHex(id, kIdDigits);
  return ours ? id : std::string_view();
}

Result<void> CheckAlive(Session& session, std::string_view file_name) {
  const std::string_view maker = MakerOf(file_name);
  if (maker.empty()) return {};
  bool alive = false;
  auto asked = session.Query(
      "SELECT 1 FROM processes WHERE id = ? FOR KEY SHARE", [&](const Row&) { alive = true; },
      maker);
  if (!asked) return Forward(asked);
  if (alive) return {};
  return FailDatabaseAway(
      "this process was away for longer than its lease: what it had begun is void; ask again");
}

}  // namespace strata::server
