// The stores' database behind a few calls: statements with their values, rows, transactions. Either
// SQLite in the data folder, for one process, or PostgreSQL (postgres.h), for several.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>

#include "core/result.h"
#include "server/store/clock.h"

namespace strata::server {

/// A row of an answer; valid inside the function that is called with it. Columns count from 0.
class Row {
 public:
  virtual ~Row() = default;
  virtual bool IsNull(int column) const = 0;
  /// 0 for NULL.
  virtual std::int64_t Int(int column) const = 0;
  /// "" for NULL.
  virtual std::string Text(int column) const = 0;
  std::optional<std::int64_t> MaybeInt(int column) const {
    return IsNull(column) ? std::nullopt : std::optional(Int(column));
  }
};

/// What stands for a `?`: an integer or a text, either of which may be NULL.
struct SqlValue {
  enum class Type : std::uint8_t { kInt, kText } type = Type::kInt;
  bool null = true;
  std::int64_t number = 0;
  std::string_view text;  ///< Of the caller; outlives the statement's run.
};

using RowUse = std::function<void(const Row&)>;

/// What a kind of database does behind a Session.
class SessionLink {
 public:
  virtual ~SessionLink() = default;  ///< Takes back what was not committed.
  virtual Result<std::int64_t> Run(std::string_view sql, std::span<const SqlValue> values,
                                   const RowUse* use) = 0;
  virtual Result<void> RunScript(const std::string& sql) = 0;
  virtual Result<void> Commit() = 0;
  virtual Result<Timestamp> Now() = 0;
};

/// The database, to one thread, for a few statements: no file is written, and no other store
/// called, between its making and its end. Over SQLite every other thread waits meanwhile.
class Session {
 public:
  explicit Session(std::unique_ptr<SessionLink> link) : link_(std::move(link)) {}

  /// Runs a statement, its `?` replaced in order by the values (`?2`: by the second): integers,
  /// text, and optionals of both (NULL). Statements are prepared once and kept, so `sql` is one of
  /// few texts, which both kinds of database understand. Returns how many rows changed.
  /// Errors: kIo (full disk included; see IsDatabaseAway), kCorruptInput (a damaged database),
  /// kInvalidArgument (text that is no UTF-8, PostgreSQL), kInternal (a defect: a constraint
  /// broken, wrong SQL).
  template <class... Values>
  Result<std::int64_t> Run(std::string_view sql, const Values&... values) {
    const std::array<SqlValue, sizeof...(Values)> all = {ValueOf(values)...};
    return link_->Run(sql, all, nullptr);
  }
  /// The same for a statement that answers; `use` sees each row.
  template <class... Values>
  Result<std::int64_t> Query(std::string_view sql, const RowUse& use, const Values&... values) {
    const std::array<SqlValue, sizeof...(Values)> all = {ValueOf(values)...};
    return link_->Run(sql, all, &use);
  }
  /// Runs statements without values: a script.
  Result<void> RunScript(const std::string& sql) { return link_->RunScript(sql); }

  /// The time that counts for leases: of the database where several processes share it. In a
  /// transaction: of its beginning.
  Result<Timestamp> Now() { return link_->Now(); }
  /// Makes the changes lasting, on disk on return. Once, as the last call. After an error over
  /// PostgreSQL they may be lasting or not.
  Result<void> Commit() { return link_->Commit(); }

 private:
  static SqlValue ValueOf(std::string_view text) { return {SqlValue::Type::kText, false, 0, text}; }
  template <class T>
  static SqlValue ValueOf(const T& value) {
    if constexpr (std::is_integral_v<T>) {
      return {SqlValue::Type::kInt, false, static_cast<std::int64_t>(value), {}};
    } else {
      return ValueOf(std::string_view(value));
    }
  }
  template <class T>
  static SqlValue ValueOf(const std::optional<T>& value) {
    if (value) return ValueOf(*value);
    return {std::is_integral_v<T> ? SqlValue::Type::kInt : SqlValue::Type::kText, true, 0, {}};
  }

  std::unique_ptr<SessionLink> link_;
};

/// Told of what other processes changed. Called by a thread of the database's, one call at a time,
/// between Listen and the end of what Listen returned.
struct Listening {
  /// `channel` is one of those asked for; `text` what the change's trigger says (schema.cc).
  std::function<void(const std::string& channel, const std::string& text)> told;
  /// Something may have been missed (a new connection), or 5 s have passed: look.
  std::function<void()> look;
};

/// Stops the listening with its end.
class Listener {
 public:
  virtual ~Listener() = default;
};

/// Threads: any.
class Database {
 public:
  /// One SQLite file in WAL mode with full syncs and foreign keys; sessions take turns. Creates
  /// what is missing. Other programs may read the file at the same time (the sqlite3 command, a
  /// backup). `clock` outlives it. Errors: kIo, kCorruptInput (no database).
  static Result<std::unique_ptr<Database>> Open(const std::string& path, const Clock& clock);
  static Result<std::unique_ptr<Database>> Open(const std::string& path);
  virtual ~Database() = default;

  /// A session without a transaction: each statement stands for itself.
  virtual Session Read() = 0;
  /// A session in a transaction, the only one of its kind at a time among all processes. Errors:
  /// kIo, when another keeps the database locked for longer than 5 s (PostgreSQL: 10 s).
  virtual Result<Session> Write() = 0;
  /// A session in a transaction that locks the rows it changes, and no more: other processes change
  /// other rows meanwhile.
  virtual Result<Session> WriteRows() = 0;

  /// Whether other processes have it open too, and change what they like at any time.
  virtual bool shared() const = 0;
  /// What a SELECT ends with in WriteRows to lock its rows: wait for those another has locked, or
  /// pass over them.
  std::string for_update() const { return shared() ? " FOR UPDATE" : ""; }
  std::string skip_locked() const { return shared() ? " FOR UPDATE SKIP LOCKED" : ""; }
  /// Null where the database is not shared: nobody else changes anything.
  virtual std::unique_ptr<Listener> Listen(Listening listening) = 0;
};

/// Of errors that a database is away: it could not be reached, or did not answer in time. Code kIo;
/// trying again later may help.
inline constexpr ErrorKind kDatabaseAway;
inline bool IsDatabaseAway(const Error& error) { return error.kind == &kDatabaseAway; }
/// Such an error, which says so in front of `why`.
inline tl::unexpected<Error> FailDatabaseAway(const std::string& why) {
  return Fail(ErrorCode::kIo, "the database is away: " + why, &kDatabaseAway);
}

}  // namespace strata::server
