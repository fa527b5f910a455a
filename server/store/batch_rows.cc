#include "server/store/batch_rows.h"

namespace strata::server {
namespace {

const std::string kColumns = "id, created, state, text, holder, attempts, cancel, revision";

BatchRow ReadRow(const Row& row) {
  BatchRow batch;
  batch.id = row.Text(0);
  batch.created = row.Int(1);
  batch.state = static_cast<BatchState>(row.Int(2));
  batch.text = row.Text(3);
  batch.holder = row.Text(4);
  batch.attempts = row.Int(5);
  batch.cancel = row.Int(6) != 0;
  batch.revision = row.Int(7);
  return batch;
}

std::int64_t NumberOf(BatchState state) { return static_cast<std::int64_t>(state); }

}  // namespace

Result<void> BatchRows::Insert(const std::string& id, std::int64_t created, const std::string& text,
                               std::uint64_t most_queued) {
  auto session = database_.Write();
  if (!session) return Forward(session);
  std::int64_t queued = 0;
  auto counted = session->Query("SELECT count(*) FROM batches WHERE state = 1",
                                [&](const Row& row) { queued = row.Int(0); });
  if (!counted) return Forward(counted);
  if (static_cast<std::uint64_t>(queued) >= most_queued) {
    return Fail(ErrorCode::kOverBudget, std::to_string(queued) + " batches wait already");
  }
  auto inserted = session->Run("INSERT INTO batches (id, created, state, text) VALUES (?, ?, 1, ?)",
                               id, created, text);
  if (!inserted) return Forward(inserted);
  return session->Commit();
}

Result<std::optional<BatchRow>> BatchRows::Get(const std::string& id) {
  std::optional<BatchRow> found;
  auto asked = database_.Read().Query(
      "SELECT " + kColumns + " FROM batches WHERE id = ?",
      [&](const Row& row) { found = ReadRow(row); }, id);
  if (!asked) return Forward(asked);
  return found;
}

Result<std::vector<BatchRow>> BatchRows::List(const std::optional<Place>& before,
                                              std::size_t count) {
  std::vector<BatchRow> rows;
  const Place from = before.value_or(Place{INT64_MAX, ""});
  auto listed = database_.Read().Query(
      "SELECT " + kColumns +
          " FROM batches WHERE created < ?1 OR (created = ?1 AND id < ?2)"
          " ORDER BY created DESC, id DESC LIMIT ?3",
      [&](const Row& row) { rows.push_back(ReadRow(row)); }, from.created, from.id,
      static_cast<std::int64_t>(count));
  if (!listed) return Forward(listed);
  return rows;
}

Result<std::optional<BatchRow>> BatchRows::Claim() {
  static const std::string kClaim =
      "UPDATE batches SET state = 2, holder = ?1, attempts = attempts + 1, revision = revision + 1"
      " WHERE id = (SELECT id FROM batches WHERE state = 1 OR (state = 2 AND NOT EXISTS"
      "   (SELECT 1 FROM processes WHERE processes.id = batches.holder AND processes.id <> ?1))"
      "   ORDER BY created, id LIMIT 1 FOR UPDATE SKIP LOCKED)"
      " AND EXISTS (SELECT 1 FROM processes WHERE processes.id = ?1) RETURNING " +
      kColumns;
  std::optional<BatchRow> claimed;
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  auto updated = session->Query(
      kClaim, [&](const Row& row) { claimed = ReadRow(row); }, membership_.id());
  if (!updated) return Forward(updated);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return claimed;
}

Result<bool> BatchRows::Change(const BatchRow& claimed, const Update& update) {
  const bool given_back = update.state == BatchState::kQueued;
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  const auto now = session->Now();
  if (!now) return Forward(now);
  std::optional<std::int64_t> ended;
  if (update.state == BatchState::kEnded) ended = ToMillis(*now);
  auto updated = session->Run(
      "UPDATE batches SET state = ?1, text = ?2, ended = ?3, attempts = attempts - ?4,"
      " holder = CASE WHEN ?4 = 1 THEN '' ELSE holder END, revision = revision + 1"
      " WHERE id = ?5 AND state = 2 AND holder = ?6 AND attempts = ?7"
      " AND EXISTS (SELECT 1 FROM processes WHERE processes.id = ?6)",
      NumberOf(update.state), update.text, ended, std::int64_t{given_back}, claimed.id,
      claimed.holder, claimed.attempts);
  if (!updated) return Forward(updated);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return *updated == 1;
}

Result<std::optional<BatchRow>> BatchRows::Cancel(
    const std::string& id,
    const std::function<std::string(const std::string& text, std::int64_t now)>& cancelled) {
  auto session = database_.WriteRows();
  if (!session) return Forward(session);
  std::optional<BatchRow> row;
  auto asked = session->Query(
      "SELECT " + kColumns + " FROM batches WHERE id = ? FOR UPDATE",
      [&](const Row& found) { row = ReadRow(found); }, id);
  if (!asked) return Forward(asked);
  if (!row || row->state == BatchState::kEnded || row->cancel) return row;
  const auto now = session->Now();
  if (!now) return Forward(now);
  row->cancel = true;
  ++row->revision;
  std::optional<std::int64_t> ended;
  if (row->state == BatchState::kQueued) {
    row->state = BatchState::kEnded;
    row->text = cancelled(row->text, ToMillis(*now));
    ended = ToMillis(*now);
  }
  auto updated = session->Run(
      "UPDATE batches SET cancel = 1, state = ?, text = ?, ended = ?, revision = revision + 1"
      " WHERE id = ?",
      NumberOf(row->state), row->text, ended, id);
  if (!updated) return Forward(updated);
  if (auto committed = session->Commit(); !committed) return Forward(committed);
  return row;
}

Result<std::vector<std::string>> BatchRows::EndedBefore(Milliseconds age) {
  std::vector<std::string> ids;
  Session session = database_.Read();
  const auto now = session.Now();
  if (!now) return Forward(now);
  auto asked = session.Query(
      "SELECT id FROM batches WHERE ended IS NOT NULL AND ended < ?",
      [&](const Row& row) { ids.push_back(row.Text(0)); }, ToMillis(*now - age));
  if (!asked) return Forward(asked);
  return ids;
}

Result<void> BatchRows::Remove(const std::string& id) {
  auto removed = database_.Read().Run("DELETE FROM batches WHERE id = ?", id);
  if (!removed) return Forward(removed);
  return {};
}

}  // namespace strata::server
