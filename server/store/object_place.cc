#include "server/store/object_place.h"

#include <utility>

#include "server/store/database.h"

namespace strata::server {
namespace {

thread_local Meanwhile* innermost = nullptr;

}  // namespace

Result<std::optional<std::uint64_t>> ObjectPlace::Find(const std::string& name) {
  const auto found = FindVersion(name);
  if (!found) return Forward(found);
  return *found ? std::optional((*found)->size) : std::optional<std::uint64_t>();
}

bool IsStoreAway(const Error& error) { return IsBucketAway(error) || IsDatabaseAway(error); }

Meanwhile::Meanwhile(std::function<bool()> gone)
    : gone_(std::move(gone)), outer_(std::exchange(innermost, this)) {}

Meanwhile::~Meanwhile() { innermost = outer_; }

bool Meanwhile::Gone() { return innermost != nullptr && innermost->gone_ && innermost->gone_(); }

}  // namespace strata::server
