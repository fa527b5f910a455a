#include "server/store/database.h"

#include <sqlite3.h>

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

}  // namespace

bool Row::IsNull(int column) const {
  return sqlite3_column_type(statement_, column) == SQLITE_NULL;
}

std::int64_t Row::Int(int column) const { return sqlite3_column_int64(statement_, column); }

std::string Row::Text(int column) const {
  const auto* text = reinterpret_cast<const char*>(sqlite3_column_text(statement_, column));
  if (text == nullptr) return {};
  return {text, static_cast<std::size_t>(sqlite3_column_bytes(statement_, column))};
}

std::optional<std::int64_t> Row::MaybeInt(int column) const {
  return IsNull(column) ? std::nullopt : std::optional(Int(column));
}

int Session::BindAt(sqlite3_stmt* statement, int place, std::int64_t value) {
  return sqlite3_bind_int64(statement, place, value);
}

int Session::BindAt(sqlite3_stmt* statement, int place, std::string_view value) {
  // The values outlive the run, and a null pointer would bind NULL.
  const char* text = value.empty() ? "" : value.data();
  return sqlite3_bind_text64(statement, place, text, value.size(), SQLITE_STATIC, SQLITE_UTF8);
}

int Session::BindAt(sqlite3_stmt* statement, int place, std::nullopt_t) {
  return sqlite3_bind_null(statement, place);
}

Result<std::int64_t> Session::RunBound(std::string_view sql, const Bind& bind,
                                       const std::function<void(const Row&)>* use) {
  auto statement = database_->Prepared(sql);
  if (!statement) return Forward(statement);
  int code = bind(*statement);
  if (code == SQLITE_OK) {
    const Row row(*statement);
    while ((code = sqlite3_step(*statement)) == SQLITE_ROW) {
      if (use != nullptr) (*use)(row);
    }
  }
  Result<std::int64_t> result = sqlite3_changes64(database_->handle_);
  if (code != SQLITE_DONE) result = database_->FailSql(std::string(sql));
  sqlite3_reset(*statement);
  sqlite3_clear_bindings(*statement);
  return result;
}

Result<void> Session::RunScript(const std::string& sql) {
  if (sqlite3_exec(database_->handle_, sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK) {
    return {};
  }
  return database_->FailSql(sql);
}

std::int64_t Session::LastNumber() const { return sqlite3_last_insert_rowid(database_->handle_); }

Result<void> Session::Commit() {
  auto committed = Run("COMMIT");
  if (!committed) return Forward(committed);
  return {};
}

Session::~Session() {
  // In a transaction still: no Commit, or one that failed.
  if (lock_.owns_lock() && sqlite3_get_autocommit(database_->handle_) == 0) {
    sqlite3_exec(database_->handle_, "ROLLBACK", nullptr, nullptr, nullptr);
  }
}

Result<std::unique_ptr<Database>> Database::Open(const std::string& path) {
  std::unique_ptr<Database> database(new Database);
  database->path_ = path;
  const int flags =
      SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX | SQLITE_OPEN_NOFOLLOW;
  if (sqlite3_open_v2(path.c_str(), &database->handle_, flags, nullptr) != SQLITE_OK) {
    return database->FailSql("cannot be opened");
  }
  sqlite3_extended_result_codes(database->handle_, 1);
  sqlite3_busy_timeout(database->handle_, kBusyTimeoutMs);
  if (auto set = database->Read().RunScript(kPragmas); !set) return Forward(set);
  return database;
}

Database::~Database() {
  for (const auto& [sql, statement] : statements_) sqlite3_finalize(statement);
  sqlite3_close(handle_);
}

Session Database::Read() { return {*this, std::unique_lock(mutex_)}; }

Result<Session> Database::Write() {
  Session session(*this, std::unique_lock(mutex_));
  if (auto begun = session.Run("BEGIN IMMEDIATE"); !begun) return Forward(begun);
  return session;
}

Result<sqlite3_stmt*> Database::Prepared(std::string_view sql) {
  const auto found = statements_.find(std::string(sql));
  if (found != statements_.end()) return found->second;
  sqlite3_stmt* statement = nullptr;
  const int code = sqlite3_prepare_v3(handle_, sql.data(), static_cast<int>(sql.size()),
                                      SQLITE_PREPARE_PERSISTENT, &statement, nullptr);
  if (code != SQLITE_OK) return FailSql(std::string(sql));
  return statements_.emplace(sql, statement).first->second;
}

tl::unexpected<Error> Database::FailSql(const std::string& what) const {
  const int code = handle_ == nullptr ? SQLITE_NOMEM : sqlite3_extended_errcode(handle_);
  const char* reason = handle_ == nullptr ? "out of memory" : sqlite3_errmsg(handle_);
  return Fail(CodeOf(code), path_ + ": " + reason + " (SQLite's code " + std::to_string(code) +
                                ", in: " + what.substr(0, 80) + ")");
}

}  // namespace strata::server
