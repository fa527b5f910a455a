#include "core/simd_target.h"

#include <hwy/highway.h>

#include <cstdint>

#include "core/lower_case.h"

namespace strata {

namespace {
std::vector<std::int64_t> CompiledTargets() {
  std::vector<std::int64_t> targets;
  for (std::int64_t left = hwy::SupportedTargets() & HWY_TARGETS; left != 0; left &= left - 1) {
    targets.push_back(left & -left);
  }
  return targets;
}
}  // namespace

std::vector<std::string> SimdTargets() {
  std::vector<std::string> names;
  for (const std::int64_t target : CompiledTargets()) {
    names.push_back(LowerCase(hwy::TargetName(target)));
  }
  return names;
}

Result<void> ForceSimdTarget(std::string_view name) {
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().DeInit();
  if (name == "auto") return {};
  std::string known;
  for (const std::int64_t target : CompiledTargets()) {
    const std::string candidate = LowerCase(hwy::TargetName(target));
    known += (known.empty() ? "" : ", ") + candidate;
    if (candidate != name) continue;
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().DeInit();
    return {};
  }
  return Fail(ErrorCode::kInvalidArgument, "instruction set '" + std::string(name) +
                                               "' is not to be had here; expected auto, " + known);
}

}  // namespace strata
