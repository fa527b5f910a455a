// This process among those that share a store: it lives as long as it says so.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/store/database.h"

namespace strata::server {

/// A row of `processes`, leased: a process that does not renew it in time is dead, whatever it may
/// still do. What it was about to make lasting is refused then (CheckAlive), and its files go, for
/// their names begin with its id. Over SQLite there is one process, the folder's lock stands for
/// its life, and none of this does anything. Threads: any.
class Membership {
 public:
  /// `database` outlives it. Errors: kIo.
  static Result<std::unique_ptr<Membership>> Join(Database& database, Milliseconds lease);
  ~Membership();  ///< Leaves.

  bool shared() const { return database_.shared(); }
  /// "" over SQLite.
  std::string id() const;
  /// A file's name that nobody else makes: "ID.N", over SQLite random.
  std::string NewName();
  /// Renews the lease; joins anew, under another id, if it was declared dead meanwhile.
  Result<void> Renew();
  /// Declares those dead whose lease has run out. Returns how many. Errors: kIo.
  Result<std::size_t> ExpireOthers();
  /// Ids of those that live. Errors: kIo.
  Result<std::vector<std::string>> Living();

 private:
  Membership(Database& database, Milliseconds lease) : database_(database), lease_(lease) {}
  Result<void> Enter();

  Database& database_;
  const Milliseconds lease_;
  mutable std::mutex mutex_;
  std::string id_;
  std::atomic<std::uint64_t> names_{0};
};

/// The id of the process that made a file of this name; "" for another kind of name.
std::string_view MakerOf(std::string_view file_name);

/// In a transaction: that the maker of `file_name` lives, and does until the end of the
/// transaction. Errors: IsDatabaseAway if it is dead: it was away itself.
Result<void> CheckAlive(Session& session, std::string_view file_name);

/// host:pid, for people.
std::string ProcessName();

}  // namespace strata::server
