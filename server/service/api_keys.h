// Who may ask for what.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "server/service/problem.h"

namespace strata::server {

/// What a key allows. kRead: everything that changes nothing (GET, HEAD and their like in gRPC).
enum class Role { kRead, kFull };

/// Whom a request comes from. Without keys configured everybody is "anonymous" and may do all.
struct Caller {
  std::string name = "anonymous";
  Role role = Role::kFull;
};

/// The keys of a file, by their SHA-256: the keys themselves stand nowhere. They are 256 random
/// bits, so that a fast hash without salt is as good as a slow one. Threads: any, once made.
class ApiKeys {
 public:
  ApiKeys() = default;  ///< No keys: everybody may do all.

  /// Lines of "<sha-256 in hex> <full|read> <name>"; empty ones and those that begin with # say
  /// nothing. Errors: kNotFound, kIo, kInvalidArgument (names the line).
  static Result<ApiKeys> Load(const std::string& path);

  bool empty() const { return rows_.empty(); }

  /// The caller who presents `authorization`, the value of that header ("Bearer KEY"; empty: none).
  /// Takes the same time whichever row fits. Refuses: kUnauthenticated; kForbidden where the key
  /// is known and `needed` is more than its role.
  Answer<Caller> Check(std::string_view authorization, Role needed) const;

 private:
  struct Row {
    std::string hash;
    Caller caller;
  };
  std::vector<Row> rows_;
};

/// A new key and the line that lets it in.
struct NewKey {
  std::string key, line;
};
/// Errors: kInvalidArgument for a name of anything but 1 to 64 letters, digits, - _ . @; kIo when
/// the system gives no randomness.
Result<NewKey> MakeKey(const std::string& name, Role role);

}  // namespace strata::server
