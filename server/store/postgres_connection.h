// One connection to PostgreSQL. Only the two sources of the database over PostgreSQL include this.
#pragma once

#include <libpq-fe.h>

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "core/result.h"
#include "server/store/database.h"

namespace strata::server {

struct PgResultEnd {
  void operator()(PGresult* result) const { PQclear(result); }
};
using PgResult = std::unique_ptr<PGresult, PgResultEnd>;

/// Where to connect to. Threads: any, read only.
class PgTarget {
 public:
  /// Errors: kInvalidArgument; the message does not repeat what was given.
  static Result<PgTarget> Parse(const std::string& url, const std::string& password,
                                const std::string& schema);
  /// For messages: user, host, port and database.
  const std::string& name() const { return name_; }
  const std::string& schema() const { return schema_; }

 private:
  friend class PgConnection;
  std::vector<std::pair<std::string, std::string>> parameters_;
  std::string name_, schema_;
};

/// Threads: one at a time.
class PgConnection {
 public:
  /// Errors: kIo, IsDatabaseAway.
  static Result<std::unique_ptr<PgConnection>> Open(const PgTarget& target);
  ~PgConnection() { PQfinish(handle_); }
  PgConnection(const PgConnection&) = delete;
  PgConnection& operator=(const PgConnection&) = delete;

  /// Statements without values; the answer of the last.
  Result<PgResult> Exec(const std::string& sql);
  /// One statement, `?` for its values; prepared by its first run.
  Result<PgResult> Run(std::string_view sql, std::span<const SqlValue> values);

  /// Whether the next statement can be tried. Not on a server that takes no changes (any more):
  /// whoever connects anew may find the one that does.
  bool alive() const { return PQstatus(handle_) == CONNECTION_OK && !read_only_; }
  bool in_transaction() const { return PQtransactionStatus(handle_) != PQTRANS_IDLE; }
  PGconn* handle() { return handle_; }
  /// An error that names the database, with libpq's reason.
  tl::unexpected<Error> FailLost(const std::string& what) const;

 private:
  explicit PgConnection(const PgTarget& target) : target_(target) {}
  Result<std::string> Prepared(std::string_view sql, std::span<const SqlValue> values);
  Result<PgResult> Check(PgResult result, std::string_view sql);

  const PgTarget& target_;
  PGconn* handle_ = nullptr;
  bool read_only_ = false;
  std::unordered_map<std::string, std::string> statements_;  // SQL → its name.
};

/// `?` and `?2` as PostgreSQL writes them: `$1`, `$2`.
std::string NumberPlaces(std::string_view sql);

}  // namespace strata::server
