// SQLite behind a few calls: statements with their values, rows, transactions.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>

#include "core/result.h"

struct sqlite3;
struct sqlite3_stmt;

namespace strata::server {

/// A row of an answer; valid inside the function that is called with it. Columns count from 0.
class Row {
 public:
  explicit Row(sqlite3_stmt* statement) : statement_(statement) {}
  bool IsNull(int column) const;
  /// 0 for NULL.
  std::int64_t Int(int column) const;
  /// "" for NULL.
  std::string Text(int column) const;
  std::optional<std::int64_t> MaybeInt(int column) const;

 private:
  sqlite3_stmt* statement_;
};

class Database;

/// The database, to one thread. While a session lives every other thread waits for it: no file is
/// written, and no other store called, between its making and its end.
class Session {
 public:
  Session(Session&&) noexcept = default;
  ~Session();  ///< Takes back what Commit did not make lasting.

  /// Runs a statement, its `?` replaced in order by the values: integers, text, and optionals of
  /// both (NULL). Statements are prepared once and kept, so `sql` is one of few texts.
  /// Returns how many rows changed. Errors: kIo (full disk included), kCorruptInput (a damaged
  /// database), kInternal (a defect: a constraint broken, wrong SQL).
  template <class... Values>
  Result<std::int64_t> Run(std::string_view sql, const Values&... values) {
    return RunBound(
        sql, [&](sqlite3_stmt* s) { return BindAll(s, values...); }, nullptr);
  }
  /// The same for a statement that answers; `use` sees each row.
  template <class... Values>
  Result<std::int64_t> Query(std::string_view sql, const std::function<void(const Row&)>& use,
                             const Values&... values) {
    return RunBound(
        sql, [&](sqlite3_stmt* s) { return BindAll(s, values...); }, &use);
  }
  /// Runs statements without values: a script.
  Result<void> RunScript(const std::string& sql);

  /// The number that the last INSERT gave its row.
  std::int64_t LastNumber() const;
  /// Makes the changes lasting, on disk on return. Once, as the last call.
  Result<void> Commit();

 private:
  friend class Database;
  using Bind = std::function<int(sqlite3_stmt*)>;

  Session(Database& database, std::unique_lock<std::mutex> lock)
      : database_(&database), lock_(std::move(lock)) {}
  Result<std::int64_t> RunBound(std::string_view sql, const Bind& bind,
                                const std::function<void(const Row&)>* use);

  static int BindAt(sqlite3_stmt* statement, int place, std::int64_t value);
  static int BindAt(sqlite3_stmt* statement, int place, std::string_view value);
  static int BindAt(sqlite3_stmt* statement, int place, std::nullopt_t);
  template <class T>
  static int BindAt(sqlite3_stmt* statement, int place, const std::optional<T>& value) {
    return value ? BindAt(statement, place, *value) : BindAt(statement, place, std::nullopt);
  }
  template <class... Values>
  static int BindAll([[maybe_unused]] sqlite3_stmt* statement, const Values&... values) {
    int place = 0, code = 0;
    ((code = code != 0 ? code : BindAt(statement, ++place, values)), ...);
    return code;
  }

  Database* database_;
  std::unique_lock<std::mutex> lock_;  // Released: this was moved from.
};

/// One SQLite file in WAL mode with full syncs and foreign keys. Threads: any; sessions take turns.
/// Other programs may read the file at the same time (the sqlite3 command, a backup).
class Database {
 public:
  /// Creates what is missing. Errors: kIo, kCorruptInput (no database).
  static Result<std::unique_ptr<Database>> Open(const std::string& path);
  ~Database();
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;

  /// A session that only reads.
  Session Read();
  /// A session in a transaction. Errors: kIo, when another program keeps the database locked for
  /// longer than 5 s.
  Result<Session> Write();

 private:
  friend class Session;
  Database() = default;
  Result<sqlite3_stmt*> Prepared(std::string_view sql);
  tl::unexpected<Error> FailSql(const std::string& what) const;

  std::string path_;
  std::mutex mutex_;
  sqlite3* handle_ = nullptr;
  std::unordered_map<std::string, sqlite3_stmt*> statements_;
};

}  // namespace strata::server
