// Database over SQLite.
#include <sqlite3.h>

#include <filesystem>
#include <mutex>
#include <system_error>
#include <unordered_map>

#include "server/store/database.h"

namespace strata::server {
namespace {

constexpr int kBusyTimeoutMs = 5000;

// FULL: a job that was accepted is still there after the power failed, which WAL alone does not
// give.
constexpr const char* kPragmas =
    "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON;"
    "PRAGMA trusted_schema = OFF;";

ErrorCode CodeOf(int sqlite_code) {
  switch (sqlite_code & 0xff) {
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
      return ErrorCode::kCorruptInput;
    case SQLITE_NOMEM:
    case SQLITE_TOOBIG:
      return ErrorCode::kOverBudget;
    case SQLITE_FULL:
    case SQLITE_IOERR:
    case SQLITE_CANTOPEN:
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
    case SQLITE_READONLY:
    case SQLITE_PERM:
      return ErrorCode::kIo;
    default:
      return ErrorCode::kInternal;
  }
}

class SqliteRow final : public Row {
 public:
  explicit SqliteRow(sqlite3_stmt* statement) : statement_(statement) {}
  bool IsNull(int column) const override {
    return sqlite3_column_type(statement_, column) == SQLITE_NULL;
  }
  std::int64_t Int(int column) const override { return sqlite3_column_int64(statement_, column); }
  std::string Text(int column) const override {
    const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement_, column));
    if (text == nullptr) return {};
    return {text, static_cast<std::size_t>(sqlite3_column_bytes(statement_, column))};
  }

 private:
  sqlite3_stmt* statement_;
};

int Bind(sqlite3_stmt* statement, int place, const SqlValue& value) {
  if (value.null) return sqlite3_bind_null(statement, place);
  if (value.type == SqlValue::Type::kInt) {
    return sqlite3_bind_int64(statement, place, value.number);
  }
  // The values outlive the run, and a null pointer would bind NULL.
  const char* text = value.text.empty() ? "" : value.text.data();
  return sqlite3_bind_text64(statement, place, text, value.text.size(), SQLITE_STATIC, SQLITE_UTF8);
}

class SqliteDatabase final : public Database {
 public:
  explicit SqliteDatabase(const Clock& clock) : clock_(clock) {}
  ~SqliteDatabase() override;
  Result<void> OpenFile(const std::string& path);

  Session Read() override;
  Result<Session> Write() override;
  Result<Session> WriteRows() override { return Write(); }
  bool shared() const override { return false; }
  std::unique_ptr<Listener> Listen(Listening) override { return nullptr; }

 private:
  friend class SqliteLink;
  Result<sqlite3_stmt*> Prepared(std::string_view sql);
  tl::unexpected<Error> FailSql(const std::string& what) const;

  const Clock& clock_;
  std::string path_;
  std::mutex mutex_;
  sqlite3* handle_ = nullptr;
  std::unordered_map<std::string, sqlite3_stmt*> statements_;
};

class SqliteLink final : public SessionLink {
 public:
  explicit SqliteLink(SqliteDatabase& database) : database_(database), lock_(database.mutex_) {}
  ~SqliteLink() override {
    // In a transaction still: no Commit, or one that failed.
    if (sqlite3_get_autocommit(database_.handle_) == 0) {
      sqlite3_exec(database_.handle_, "ROLLBACK", nullptr, nullptr, nullptr);
    }
  }

  Result<std::int64_t> Run(std::string_view sql, std::span<const SqlValue> values,
                           const RowUse* use) override;
  Result<void> RunScript(const std::string& sql) override {
    if (sqlite3_exec(database_.handle_, sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK) {
      return {};
    }
    return database_.FailSql(sql);
  }
  Result<void> Commit() override {
    auto committed = Run("COMMIT", {}, nullptr);
    if (!committed) return Forward(committed);
    return {};
  }
  Result<Timestamp> Now() override { return database_.clock_.Now(); }

 private:
  SqliteDatabase& database_;
  std::unique_lock<std::mutex> lock_;
};

Result<std::int64_t> SqliteLink::Run(std::string_view sql, std::span<const SqlValue> values,
                                     const RowUse* use) {
  auto statement = database_.Prepared(sql);
  if (!statement) return Forward(statement);
  int code = SQLITE_OK, place = 0;
  for (const SqlValue& value : values) {
    if (code == SQLITE_OK) code = Bind(*statement, ++place, value);
  }
  if (code == SQLITE_OK) {
    const SqliteRow row(*statement);
    while ((code = sqlite3_step(*statement)) == SQLITE_ROW) {
      if (use != nullptr) (*use)(row);
    }
  }
  Result<std::int64_t> result = sqlite3_changes64(database_.handle_);
  if (code != SQLITE_DONE) result = database_.FailSql(std::string(sql));
  sqlite3_reset(*statement);
  sqlite3_clear_bindings(*statement);
  return result;
}

Result<void> SqliteDatabase::OpenFile(const std::string& path) {
  path_ = path;
  const int flags =
      SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_NOFOLLOW;
  // NOFOLLOW refuses a link anywhere in the name; only the last part must not be one. (With
  // DynamicUser systemd's state directory is reached through a link.)
  const std::filesystem::path given(path);
  std::error_code failed;
  const auto folder = std::filesystem::canonical(
      given.has_parent_path() ? given.parent_path() : std::filesystem::path("."), failed);
  const std::string real = failed ? path : (folder / given.filename()).string();
  if (sqlite3_open_v2(real.c_str(), &handle_, flags, nullptr) != SQLITE_OK) {
    return FailSql("cannot be opened");
  }
  sqlite3_extended_result_codes(handle_, 1);
  sqlite3_busy_timeout(handle_, kBusyTimeoutMs);
  return Read().RunScript(kPragmas);
}

SqliteDatabase::~SqliteDatabase() {
  for (const auto& [sql, statement] : statements_) sqlite3_finalize(statement);
  sqlite3_close(handle_);
}

Session SqliteDatabase::Read() { return Session(std::make_unique<SqliteLink>(*this)); }

Result<Session> SqliteDatabase::Write() {
  Session session = Read();
  if (auto begun = session.Run("BEGIN IMMEDIATE"); !begun) return Forward(begun);
  return session;
}

Result<sqlite3_stmt*> SqliteDatabase::Prepared(std::string_view sql) {
  const auto found = statements_.find(std::string(sql));
  if (found != statements_.end()) return found->second;
  sqlite3_stmt* statement = nullptr;
  const int code = sqlite3_prepare_v3(handle_, sql.data(), static_cast<int>(sql.size()),
                                      SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
  if (code != SQLITE_OK) return FailSql(std::string(sql));
  return statements_.emplace(sql, statement).first->second;
}

tl::unexpected<Error> SqliteDatabase::FailSql(const std::string& what) const {
  const int code = handle_ == nullptr ? SQLITE_NOMEM : sqlite3_extended_errcode(handle_);
  const char* reason = handle_ == nullptr ? "out of memory" : sqlite3_errmsg(handle_);
  return Fail(CodeOf(code), path_ + ": " + reason + " (SQLite's code " + std::to_string(code) +
                                ", in: " + what.substr(0, 80) + ")");
}

}  // namespace

Result<std::unique_ptr<Database>> Database::Open(const std::string& path, const Clock& clock) {
  auto database = std::make_unique<SqliteDatabase>(clock);
  if (auto opened = database->OpenFile(path); !opened) return Forward(opened);
  return database;
}

Result<std::unique_ptr<Database>> Database::Open(const std::string& path) {
  static const SystemClock kClock;
  return Open(path, kClock);
}

}  // namespace strata::server
