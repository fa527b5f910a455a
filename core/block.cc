#include "core/block.h"

#include <utility>

namespace strata {

void BlockReservoirs::Merge(const BlockReservoirs& other) {
  std::vector<Entry> merged;
  merged.reserve(cells.size() + other.cells.size());
  auto a = cells.begin();
  for (const Entry& entry : other.cells) {
    while (a != cells.end() && a->offset < entry.offset) merged.push_back(*a++);
    merged.push_back(entry);
    if (a != cells.end() && a->offset == entry.offset)
      merged.back().reservoir.Merge((a++)->reservoir);
  }
  merged.insert(merged.end(), a, cells.end());
  cells = std::move(merged);
}

}  // namespace strata
