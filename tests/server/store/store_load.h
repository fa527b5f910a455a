// A busy service in a process of its own, to be killed at any moment.
#pragma once

#include <cstdint>
#include <string>

#include "server/store/store.h"

namespace strata::server {

/// What both sides know without telling each other.
StoreOptions LoadOptions(const std::string& data);
/// A job's right result, from its options.
std::string ResultOf(const std::string& options);
/// The content of a model or upload, from its number.
std::string ContentOf(std::uint64_t number);

/// Opens the store and makes jobs, does them, uploads, puts and deletes models until it is killed
/// or has done a bounded number of each. Whatever has been promised to it is then said on standard
/// output, a line each:
///
///     ready
///     job ID OPTIONS            made
///     done ID                   finished with its result
///     cancelled ID
///     twice ID                  a job was claimed while it ran: must not happen
///     upload ID MODEL NUMBER    begun
///     offset ID BYTES           durable
///     model NAME NUMBER         an upload has become this model
///     try NAME NUMBER           about to be put
///     put NAME NUMBER           is put
///     gone NAME                 is deleted
///
/// Returns the exit status.
int RunLoad(const std::string& data, std::uint64_t round);

}  // namespace strata::server
