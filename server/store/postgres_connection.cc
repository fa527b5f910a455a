#include "server/store/postgres_connection.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <map>
#include <optional>

namespace strata::server {
namespace {

constexpr Oid kInt8Oid = 20, kTextOid = 25;

// A process that is paused in the middle of a transaction would keep its locks, the one of all
// writers included: the database ends such a session, and a waiter gives up before its client does.
constexpr const char* kSettings =
    "SET client_min_messages = error; SET lock_timeout = '10s';"
    "SET idle_in_transaction_session_timeout = '8s'; SET statement_timeout = '30s';"
    "SET TimeZone = 'UTC'; SET standard_conforming_strings = on;";

// Found gone within about 15 s, also when no packet says so.
constexpr std::array<std::pair<const char*, const char*>, 6> kUsual = {{
    {"connect_timeout", "5"},
    {"keepalives_idle", "5"},
    {"keepalives_interval", "3"},
    {"keepalives_count", "3"},
    {"tcp_user_timeout", "15000"},
    {"application_name", "strata"},
}};

std::string OneLine(const char* text) {
  std::string line = text == nullptr ? "" : text;
  std::ranges::replace(line, '\n', ' ');
  while (line.ends_with(' ')) line.pop_back();
  return line;
}

// What a server says that became, or still is, another one's copy.
constexpr std::string_view kReadOnly = "25006";

/// What an SQLSTATE means to a caller; nothing: away for now.
std::optional<ErrorCode> CodeOf(std::string_view state) {
  constexpr std::array<std::string_view, 9> kAway = {"08",    "57",    "25P03", kReadOnly, "40",
                                                     "53300", "55P03", "28",    "3D"};
  if (std::ranges::any_of(kAway, [&](auto start) { return state.starts_with(start); })) {
    return std::nullopt;
  }
  if (state == "22021" || state == "22P05") return ErrorCode::kInvalidArgument;
  if (state.starts_with("53") || state.starts_with("58")) return ErrorCode::kIo;
  if (state.starts_with("XX")) return ErrorCode::kCorruptInput;
  return ErrorCode::kInternal;
}

}  // namespace

Result<PgTarget> PgTarget::Parse(const std::string& url, const std::string& password,
                                 const std::string& schema) {
  PgTarget target;
  target.schema_ = schema;
  if (schema.empty() || !std::ranges::all_of(schema, [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '_';
      })) {
    return Fail(ErrorCode::kInvalidArgument, "database: the schema's name is not letters, digits");
  }
  char* reason = nullptr;
  PQconninfoOption* const parsed = PQconninfoParse(url.c_str(), &reason);
  PQfreemem(reason);  // It may repeat what was given, the password included.
  if (parsed == nullptr) {
    return Fail(ErrorCode::kInvalidArgument,
                "--database: expected postgresql://[USER@]HOST[:PORT]/NAME (special characters as "
                "%XX)");
  }
  std::map<std::string, std::string> all(kUsual.begin(), kUsual.end());
  for (const PQconninfoOption* option = parsed; option->keyword != nullptr; ++option) {
    if (option->val != nullptr) all[option->keyword] = option->val;
  }
  PQconninfoFree(parsed);
  if (!password.empty()) all["password"] = password;
  all["client_encoding"] = "UTF8";
  target.name_ = "postgresql://" + (all["user"].empty() ? "" : all["user"] + "@") + all["host"] +
                 (all["port"].empty() ? "" : ":" + all["port"]) + "/" + all["dbname"];
  std::erase_if(all, [](const auto& entry) { return entry.second.empty(); });
  target.parameters_.assign(all.begin(), all.end());
  return target;
}

Result<std::unique_ptr<PgConnection>> PgConnection::Open(const PgTarget& target) {
  std::vector<const char*> names, values;
  for (const auto& [name, value] : target.parameters_) {
    names.push_back(name.c_str());
    values.push_back(value.c_str());
  }
  names.push_back(nullptr);
  values.push_back(nullptr);
  std::unique_ptr<PgConnection> connection(new PgConnection(target));
  connection->handle_ = PQconnectdbParams(names.data(), values.data(), 0);
  if (!connection->alive()) return connection->FailLost("cannot connect");
  PQsetNoticeProcessor(
      connection->handle_, [](void*, const char*) {}, nullptr);
  auto set = connection->Exec(kSettings + std::string("SET search_path = ") + target.schema_);
  if (!set) return Forward(set);
  return connection;
}

tl::unexpected<Error> PgConnection::FailLost(const std::string& what) const {
  const std::string reason =
      handle_ == nullptr ? "out of memory" : OneLine(PQerrorMessage(handle_));
  return FailDatabaseAway(target_.name() + ": " + what + ": " + reason);
}

Result<PgResult> PgConnection::Check(PgResult result, std::string_view sql) {
  const ExecStatusType status = PQresultStatus(result.get());
  if (status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK) return result;
  const char* const found = PQresultErrorField(result.get(), PG_DIAG_SQLSTATE);
  const std::string state = found == nullptr ? "" : found;
  if (!alive() || state.empty()) return FailLost("the connection broke");
  read_only_ = read_only_ || state == kReadOnly;
  const auto code = CodeOf(state);
  const std::string message =
      target_.name() + ": " + OneLine(PQresultErrorField(result.get(), PG_DIAG_MESSAGE_PRIMARY)) +
      " (SQLSTATE " + state + ", in: " + std::string(sql.substr(0, 80)) + ")";
  if (!code) return FailDatabaseAway(message);
  return Fail(*code, message);
}

Result<PgResult> PgConnection::Exec(const std::string& sql) {
  return Check(PgResult(PQexec(handle_, sql.c_str())), sql);
}

Result<std::string> PgConnection::Prepared(std::string_view sql, std::span<const SqlValue> values) {
  const auto known = statements_.find(std::string(sql));
  if (known != statements_.end()) return known->second;
  std::vector<Oid> types;
  for (const SqlValue& value : values) {
    types.push_back(value.type == SqlValue::Type::kInt ? kInt8Oid : kTextOid);
  }
  const std::string name = "s" + std::to_string(statements_.size());
  auto made = Check(PgResult(PQprepare(handle_, name.c_str(), NumberPlaces(sql).c_str(),
                                       static_cast<int>(types.size()), types.data())),
                    sql);
  if (!made) return Forward(made);
  statements_.emplace(sql, name);
  return name;
}

Result<PgResult> PgConnection::Run(std::string_view sql, std::span<const SqlValue> values) {
  const auto name = Prepared(sql, values);
  if (!name) return Forward(name);
  std::vector<std::string> texts;
  texts.reserve(values.size());
  std::vector<const char*> pointers;
  for (const SqlValue& value : values) {
    if (value.text.find('\0') != std::string_view::npos) {
      return Fail(ErrorCode::kInvalidArgument, "a text holds a byte 0, which no database takes");
    }
    texts.push_back(value.type == SqlValue::Type::kInt ? std::to_string(value.number)
                                                       : std::string(value.text));
    pointers.push_back(value.null ? nullptr : texts.back().c_str());
  }
  return Check(PgResult(PQexecPrepared(handle_, name->c_str(), static_cast<int>(pointers.size()),
                                       pointers.data(), nullptr, nullptr, 0)),
               sql);
}

std::string NumberPlaces(std::string_view sql) {
  std::string numbered;
  int count = 0;
  bool quoted = false;
  for (std::size_t i = 0; i < sql.size(); ++i) {
    quoted ^= sql[i] == '\'';
    if (sql[i] != '?' || quoted) {
      numbered += sql[i];
      continue;
    }
    numbered += '$';
    const bool given = i + 1 < sql.size() && std::isdigit(static_cast<unsigned char>(sql[i + 1]));
    if (!given) numbered += std::to_string(++count);
  }
  return numbered;
}

}  // namespace strata::server
