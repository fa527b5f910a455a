// Batches of a store that several processes share: who runs which, and how each stands.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/result.h"
#include "server/store/database.h"
#include "server/store/membership.h"

namespace strata::server {

enum class BatchState : std::uint8_t { kQueued = 1, kRunning = 2, kEnded = 3 };

/// A batch as it is kept. `text` is the owner's, opaque here.
struct BatchRow {
  std::string id;
  std::int64_t created = 0;  ///< Milliseconds since 1970.
  BatchState state = BatchState::kQueued;
  std::string text;
  std::string holder;  ///< The process that runs it, or did (Membership::id); "" for none.
  std::int64_t attempts = 0;
  bool cancel = false;  ///< Somebody wishes its end.
  std::int64_t revision = 1;
};

/// The table `batches`. A batch is run by one process, which its row names; it goes back to the
/// queue with the process's row. Every change asks for the holder, so a process that was declared
/// dead changes nothing any more. Threads: any. Errors of all: kIo, IsDatabaseAway.
class BatchRows {
 public:
  BatchRows(Database& database, Membership& membership)
      : database_(database), membership_(membership) {}

  /// Errors: also kOverBudget when `most_queued` wait already.
  Result<void> Insert(const std::string& id, std::int64_t created, const std::string& text,
                      std::uint64_t most_queued);
  Result<std::optional<BatchRow>> Get(const std::string& id);
  /// The newest first; those before (`created`, `id`), if that is given.
  struct Place {
    std::int64_t created = 0;
    std::string id;
  };
  Result<std::vector<BatchRow>> List(const std::optional<Place>& before, std::size_t count);
  /// The oldest that waits, or whose process is dead, is this process's from now on; also one that
  /// names this process already, which gave it up when the database was away. To be called while it
  /// runs none.
  Result<std::optional<BatchRow>> Claim();
  struct Update {
    BatchState state = BatchState::kRunning;
    std::string text;
  };
  /// Of a batch that was claimed; kQueued gives it back, and that attempt does not count. False: it
  /// is another's by now.
  Result<bool> Change(const BatchRow& claimed, const Update& update);
  /// Notes the wish; one that waits ends at once, with what `cancelled` makes of its text. Nothing
  /// if there is none of this name.
  Result<std::optional<BatchRow>> Cancel(
      const std::string& id,
      const std::function<std::string(const std::string& text, std::int64_t now)>& cancelled);
  /// Those that ended more than `age` ago, by the database's clock.
  Result<std::vector<std::string>> EndedBefore(Milliseconds age);
  Result<void> Remove(const std::string& id);

 private:
  Database& database_;
  Membership& membership_;
};

}  // namespace strata::server
