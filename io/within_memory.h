// Where readers run out of memory.
#pragma once

#include <memory>
#include <new>
#include <string>
#include <type_traits>
#include <utility>

#include "core/mesh_reader.h"
#include "core/result.h"

namespace strata::io {

/// What `work` returns; where it runs out of memory kOverBudget, with `message`.
template <class Work>
std::invoke_result_t<Work> WithinMemory(const std::string& message, Work&& work) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, message);
  }
}

/// A reader made of these arguments, its Load() done. Errors: those of Load.
template <class Reader, class... Arguments>
Result<std::unique_ptr<MeshReader>> MakeLoaded(Arguments&&... arguments) {
  auto reader = std::make_unique<Reader>(std::forward<Arguments>(arguments)...);
  if (auto loaded = reader->Load(); !loaded) return Forward(loaded);
  return reader;
}

}  // namespace strata::io
