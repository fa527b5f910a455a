// Which vector instructions the hot loops use. Only speed depends on it.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace strata {

/// The vector instruction sets this processor has of those compiled in, best first, lower case.
std::vector<std::string> SimdTargets();
/// Uses `name` from now on ("auto": the best). Not while a job runs. Errors: kInvalidArgument.
Result<void> ForceSimdTarget(std::string_view name);

}  // namespace strata
