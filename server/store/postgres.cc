#include "server/store/postgres.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <mutex>
#include <thread>
#include <vector>

#include "io/fd.h"
#include "server/store/postgres_connection.h"

namespace strata::server {
namespace {

using Steady = std::chrono::steady_clock;

constexpr Milliseconds kFirstDelay{100}, kLongestDelay{5000};
constexpr Milliseconds kPlaceTimeout = std::chrono::seconds(15);  // For a connection of the few.
constexpr Milliseconds kLookEvery = std::chrono::seconds(5);
constexpr const char* kNow = "SELECT (extract(epoch FROM clock_timestamp()) * 1000)::bigint";
// Which of an application's advisory locks: "St" for writers.
constexpr int kWriterLock = 0x5374;

std::int64_t ToInt(const char* text) {
  std::int64_t value = 0;
  std::from_chars(text, text + std::strlen(text), value);
  return value;
}

class PgRow final : public Row {
 public:
  PgRow(const PGresult* result, int row) : result_(result), row_(row) {}
  bool IsNull(int column) const override { return PQgetisnull(result_, row_, column) != 0; }
  std::int64_t Int(int column) const override { return ToInt(PQgetvalue(result_, row_, column)); }
  std::string Text(int column) const override {
    return {PQgetvalue(result_, row_, column),
            static_cast<std::size_t>(PQgetlength(result_, row_, column))};
  }

 private:
  const PGresult* result_;
  int row_;
};

class PostgresDatabase;

/// A connection from the pool, given back with its owner: rolled back, or closed if it broke.
class PgLease {
 public:
  PgLease() = default;
  PgLease(PostgresDatabase& database, std::unique_ptr<PgConnection> connection, bool fresh)
      : database_(&database), connection_(std::move(connection)), fresh_(fresh) {}
  PgLease(PgLease&&) = default;
  PgLease& operator=(PgLease&&) = delete;
  ~PgLease();

  PgConnection& operator*() { return *connection_; }
  PgConnection* operator->() { return connection_.get(); }
  explicit operator bool() const { return connection_ != nullptr; }
  /// Whether it was just made; another one may have been dead for hours.
  bool fresh() const { return fresh_; }

 private:
  PostgresDatabase* database_ = nullptr;
  std::unique_ptr<PgConnection> connection_;
  bool fresh_ = false;
};

class PostgresDatabase final : public Database {
 public:
  PostgresDatabase(PgTarget target, const PostgresOptions& options)
      : target_(std::move(target)),
        begin_write_("BEGIN; SELECT pg_advisory_xact_lock(" + std::to_string(kWriterLock) +
                     ", hashtext('" + target_.schema() + "')); " + kNow),
        clock_(options.clock),
        limit_(options.connections) {}

  Session Read() override;
  Result<Session> Write() override;
  Result<Session> WriteRows() override;
  bool shared() const override { return true; }
  std::unique_ptr<Listener> Listen(Listening listening) override;

  Result<PgLease> Acquire();
  /// A connection on which `sql` was run: its answer is the time, in milliseconds.
  Result<std::pair<PgLease, Timestamp>> Begin(const std::string& sql);
  /// A new connection, unless the last attempt failed a moment ago.
  Result<std::unique_ptr<PgConnection>> Connect();
  const PgTarget& target() const { return target_; }
  const Clock* clock() const { return clock_; }

 private:
  friend class PgLease;
  void GiveBack(std::unique_ptr<PgConnection> connection);

  const PgTarget target_;
  const std::string begin_write_;
  const Clock* const clock_;
  const std::size_t limit_;
  std::mutex mutex_;
  std::condition_variable given_back_;
  std::vector<std::unique_ptr<PgConnection>> idle_;
  std::size_t in_use_ = 0;
  Steady::time_point next_try_{};  // Before it nobody connects.
  Milliseconds delay_ = kFirstDelay;
  Error last_failure_;
};

PgLease::~PgLease() {
  if (!connection_) return;
  if (connection_->alive() && connection_->in_transaction()) {
    if (!connection_->Exec("ROLLBACK")) connection_->alive();
  }
  database_->GiveBack(std::move(connection_));
}

void PostgresDatabase::GiveBack(std::unique_ptr<PgConnection> connection) {
  {
    const std::lock_guard lock(mutex_);
    --in_use_;
    if (connection->alive() && !connection->in_transaction()) {
      idle_.push_back(std::move(connection));
    }
  }
  given_back_.notify_one();
}

Result<PgLease> PostgresDatabase::Acquire() {
  {
    std::unique_lock lock(mutex_);
    if (!given_back_.wait_for(lock, kPlaceTimeout, [this] { return in_use_ < limit_; })) {
      return FailDatabaseAway(target_.name() + ": all " + std::to_string(limit_) +
                              " connections are busy");
    }
    ++in_use_;
    while (!idle_.empty()) {
      auto connection = std::move(idle_.back());
      idle_.pop_back();
      // One that the server has closed meanwhile says so without being asked anything.
      if (PQconsumeInput(connection->handle()) == 0 || !connection->alive()) continue;
      return PgLease(*this, std::move(connection), false);
    }
  }
  auto connection = Connect();
  if (connection) return PgLease(*this, *std::move(connection), true);
  {
    const std::lock_guard lock(mutex_);
    --in_use_;
  }
  given_back_.notify_one();
  return Forward(connection);
}

Result<std::unique_ptr<PgConnection>> PostgresDatabase::Connect() {
  {
    const std::lock_guard lock(mutex_);
    if (Steady::now() < next_try_) return tl::unexpected<Error>(last_failure_);
  }
  auto connection = PgConnection::Open(target_);
  const std::lock_guard lock(mutex_);
  if (connection) {
    delay_ = kFirstDelay;
    return connection;
  }
  next_try_ = Steady::now() + delay_;
  delay_ = std::min(delay_ * 2, kLongestDelay);
  last_failure_ = connection.error();
  return connection;
}

Result<std::pair<PgLease, Timestamp>> PostgresDatabase::Begin(const std::string& sql) {
  while (true) {
    auto lease = Acquire();
    if (!lease) return Forward(lease);
    auto begun = (*lease)->Exec(sql);
    if (begun) {
      const Timestamp now =
          clock_ ? clock_->Now() : FromMillis(ToInt(PQgetvalue(begun->get(), 0, 0)));
      return std::pair(*std::move(lease), now);
    }
    // One that lay idle may have died long ago; a new one that fails says how things are.
    if ((*lease)->alive() || lease->fresh()) return Forward(begun);
  }
}

// --- Sessions ------------------------------------------------------------------------------------

class PgLink final : public SessionLink {
 public:
  explicit PgLink(PostgresDatabase& database) : database_(database) {}
  PgLink(PostgresDatabase& database, PgLease lease, Timestamp now)
      : database_(database), now_(now) {
    lease_.emplace(std::move(lease));
  }

  Result<std::int64_t> Run(std::string_view sql, std::span<const SqlValue> values,
                           const RowUse* use) override {
    auto result = Try(sql, values);
    if (!result) return Forward(result);
    const int rows = PQntuples(result->get());
    for (int row = 0; use != nullptr && row < rows; ++row) (*use)(PgRow(result->get(), row));
    return ToInt(PQcmdTuples(result->get()));
  }
  Result<void> RunScript(const std::string& sql) override {
    if (auto leased = Lease(); !leased) return leased;
    auto done = (*lease_)->Exec(sql);
    if (!done) return Forward(done);
    return {};
  }
  Result<void> Commit() override {
    auto done = (*lease_)->Exec("COMMIT");
    if (!done) return Forward(done);
    // A transaction that had failed answers COMMIT with ROLLBACK.
    if (std::string_view(PQcmdStatus(done->get())) == "COMMIT") return {};
    return Fail(ErrorCode::kInternal,
                database_.target().name() + ": a failed transaction committed");
  }
  Result<Timestamp> Now() override {
    if (now_) return *now_;
    if (database_.clock() != nullptr) return database_.clock()->Now();
    std::int64_t millis = 0;
    const RowUse note = [&](const Row& row) { millis = row.Int(0); };
    auto asked = Run(kNow, {}, &note);
    if (!asked) return Forward(asked);
    return FromMillis(millis);
  }

 private:
  Result<void> Lease() {
    if (lease_) return {};
    auto lease = database_.Acquire();
    if (!lease) return Forward(lease);
    lease_.emplace(*std::move(lease));
    return {};
  }
  Result<PgResult> Try(std::string_view sql, std::span<const SqlValue> values) {
    while (true) {
      if (auto leased = Lease(); !leased) return Forward(leased);
      auto result = (*lease_)->Run(sql, values);
      // Outside of transactions a question may be asked again on another connection.
      const bool again =
          !result && !now_ && !(*lease_)->alive() && !lease_->fresh() && sql.starts_with("SELECT");
      if (!again) return result;
      lease_.reset();
    }
  }

  PostgresDatabase& database_;
  std::optional<PgLease> lease_;
  std::optional<Timestamp> now_;  // Of a transaction.
};

Session PostgresDatabase::Read() { return Session(std::make_unique<PgLink>(*this)); }

Result<Session> PostgresDatabase::Write() {
  auto begun = Begin(begin_write_);
  if (!begun) return Forward(begun);
  return Session(std::make_unique<PgLink>(*this, std::move(begun->first), begun->second));
}

Result<Session> PostgresDatabase::WriteRows() {
  auto begun = Begin(std::string("BEGIN; ") + kNow);
  if (!begun) return Forward(begun);
  return Session(std::make_unique<PgLink>(*this, std::move(begun->first), begun->second));
}

// --- Listening -----------------------------------------------------------------------------------

class PgListener final : public Listener {
 public:
  PgListener(PostgresDatabase& database, Listening listening)
      : database_(database),
        listening_(std::move(listening)),
        stop_(eventfd(0, EFD_CLOEXEC)),
        thread_([this] { Work(); }) {}
  ~PgListener() override {
    stopping_ = true;
    const std::uint64_t one = 1;
    static_cast<void>(!write(stop_.get(), &one, sizeof one));
    thread_.join();
  }

 private:
  void Work() {
    while (!stopping_) {
      if (auto connection = Subscribe()) {
        // What was told before this connection was made is not told again.
        listening_.look();
        Follow(*connection);
      } else {
        Wait(-1, Milliseconds(200));  // The database's own delays are longer.
      }
    }
  }

  std::unique_ptr<PgConnection> Subscribe() {
    auto connection = database_.Connect();
    if (!connection) return nullptr;
    std::string sql;
    for (const char* channel : {"jobs", "queue", "uploads", "flights"}) {
      sql += "LISTEN " + database_.target().schema() + "_" + channel + ";";
    }
    if (!(*connection)->Exec(sql)) return nullptr;
    return *std::move(connection);
  }

  void Follow(PgConnection& connection) {
    const std::size_t prefix = database_.target().schema().size() + 1;
    auto looked = Steady::now();
    while (!stopping_) {
      Wait(PQsocket(connection.handle()), kLookEvery);
      if (PQconsumeInput(connection.handle()) == 0) return;
      while (PGnotify* const note = PQnotifies(connection.handle())) {
        if (!stopping_) listening_.told(std::string(note->relname).substr(prefix), note->extra);
        PQfreemem(note);
      }
      if (Steady::now() - looked < kLookEvery || stopping_) continue;
      looked = Steady::now();
      listening_.look();
    }
  }

  void Wait(int socket, Milliseconds timeout) {
    pollfd waited[2] = {{stop_.get(), POLLIN, 0}, {socket, POLLIN, 0}};
    poll(waited, 2, static_cast<int>(timeout.count()));
  }

  PostgresDatabase& database_;
  Listening listening_;
  io::Fd stop_;
  std::atomic<bool> stopping_{false};
  std::thread thread_;
};

std::unique_ptr<Listener> PostgresDatabase::Listen(Listening listening) {
  return std::make_unique<PgListener>(*this, std::move(listening));
}

}  // namespace

Result<std::unique_ptr<Database>> OpenPostgres(const PostgresOptions& options) {
  auto target = PgTarget::Parse(options.url, options.password, options.schema);
  if (!target) return Forward(target);
  auto database = std::make_unique<PostgresDatabase>(*std::move(target), options);
  if (auto lease = database->Acquire(); !lease) return Forward(lease);
  return database;
}

}  // namespace strata::server
