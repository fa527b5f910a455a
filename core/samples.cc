#include "core/samples.h"

#include <algorithm>
#include <utility>

namespace strata {
namespace {

template <class T>
void AppendColumn(std::vector<T>& to, std::vector<T>&& from) {
  if (to.empty()) {
    to = std::move(from);
  } else {
    to.insert(to.end(), from.begin(), from.end());
  }
}

}  // namespace

void SampleColumns::Append(SampleColumns&& more) {
  AppendColumn(position, std::move(more.position));
  AppendColumn(normal, std::move(more.normal));
  AppendColumn(triangle, std::move(more.triangle));
  AppendColumn(barycentric, std::move(more.barycentric));
  AppendColumn(cell, std::move(more.cell));
  AppendColumn(area, std::move(more.area));
  AppendColumn(weight, std::move(more.weight));
  carried.resize(std::max(carried.size(), more.carried.size()));
  for (std::size_t k = 0; k < more.carried.size(); ++k) {
    AppendColumn(carried[k], std::move(more.carried[k]));
  }
}

}  // namespace strata
