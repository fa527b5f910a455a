#include "server/store/bucket_claim.h"

#include <string>

namespace strata::server {
namespace {

constexpr const char* kMark = "store-id";
constexpr std::uint64_t kMostMarkBytes = 64;

struct Kept {
  std::string id;
  bool in_bucket = false, has_content = false;
};

Result<Kept> KeptBy(Database& database) {
  Kept kept;
  Session session = database.Read();
  auto asked = session.Query(
      database.shared() ? "SELECT store, bucket FROM meta" : "SELECT id, bucket FROM store",
      [&](const Row& row) {
        kept.id = row.Text(0);
        kept.in_bucket = row.Int(1) != 0;
      });
  if (!asked) return Forward(asked);
  for (const char* const look :
       {"SELECT 1 FROM blobs LIMIT 1", "SELECT 1 FROM uploads WHERE hash IS NULL LIMIT 1"}) {
    auto found = session.Query(look, [&](const Row&) { kept.has_content = true; });
    if (!found) return Forward(found);
  }
  return kept;
}

Result<std::string> MarkOf(ObjectPlace& place) {
  const auto size = place.Find(kMark);
  if (!size) return Forward(size);
  if (!*size) return std::string();
  if (**size > kMostMarkBytes) return std::string("something else");
  std::string mark(static_cast<std::size_t>(**size), 0);
  if (auto read = place.Read(kMark, 0, mark, {}); !read) return Forward(read);
  return mark;
}

}  // namespace

Result<void> ClaimBucket(Database& database, ObjectPlace* place) {
  const auto kept = KeptBy(database);
  if (!kept) return Forward(kept);
  if (place == nullptr) {
    if (!kept->in_bucket) return {};
    return Fail(ErrorCode::kConflict,
                "this store's content lies in a bucket: name it with --blobs s3://BUCKET/PREFIX");
  }
  if (!kept->in_bucket && kept->has_content) {
    return Fail(ErrorCode::kConflict,
                place->Shown("") +
                    ": this store's content lies in its data folder, and --blobs "
                    "does not move it (docs/operations.md tells how)");
  }
  auto mark = MarkOf(*place);
  if (!mark) return Forward(mark);
  if (mark->empty() && !kept->in_bucket) {
    const auto put = place->PutTextIfNew(kMark, kept->id);
    if (!put) return Forward(put);
    mark = MarkOf(*place);  // Of two that come at once one was first; without such a step, last.
    if (!mark) return Forward(mark);
  }
  if (*mark != kept->id) {
    return Fail(ErrorCode::kConflict, place->Shown(kMark) + ": the id '" + *mark +
                                          "' found, expected " + kept->id +
                                          ": the prefix belongs to another store");
  }
  if (kept->in_bucket) return {};
  auto noted = database.Read().Run(database.shared() ? "UPDATE meta SET bucket = 1"
                                                     : "UPDATE store SET bucket = 1");
  if (!noted) return Forward(noted);
  return {};
}

}  // namespace strata::server
