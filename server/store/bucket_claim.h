// Whose a bucket's prefix is: two stores in one would take each other's objects for leftovers.
#pragma once

#include "core/result.h"
#include "server/store/database.h"
#include "server/store/object_place.h"

namespace strata::server {

/// Sees to it that the store of `database` (migrated) keeps its content in `place`, or, where that
/// is null, in its folder. The first to come marks an unclaimed prefix with the store's id (object
/// `store-id`); of several that come at once that is one alone where ObjectPlace::PutTextIfNew is
/// one step. Errors: kConflict (another store's prefix; content lies elsewhere already),
/// IsBucketAway, kIo.
Result<void> ClaimBucket(Database& database, ObjectPlace* place);

}  // namespace strata::server
