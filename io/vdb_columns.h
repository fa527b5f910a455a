// What a sample's columns are called in a vdb, and how they lie there.
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "core/samples.h"
#include "io/vdb_stream.h"

namespace strata::io {

/// The attributes of a header's columns (docs/sample-formats.md, VDB). Threads: const members may
/// be called from any.
class VdbColumns {
 public:
  explicit VdbColumns(const SampleHeader& header);

  const std::vector<VdbAttribute>& attributes() const { return attributes_; }
  /// What the grid says of itself: the provenance, which column each attribute is, tables of names.
  std::vector<std::pair<std::string, std::string>> Metadata(const SampleHeader& header) const;

  /// The attributes of sample `i`, one after the other, to `out`. Precondition: `columns` match the
  /// header.
  void Pack(const SampleColumns& columns, std::size_t i, char* out) const;

 private:
  // How a column's value becomes an attribute's.
  enum class How { kCopy, kWiden, kColor, kAlpha, kUv };
  struct Source {
    std::string column;
    AttributeSet fixed = 0;   // Or 0: then
    std::size_t carried = 0;  // of these.
    ScalarType type = ScalarType::kFloat32;
    std::uint32_t components = 1;
    How how = How::kCopy;
  };

  std::string NameFor(const std::string& wanted) const;
  void Add(VdbAttribute attribute, Source source);
  void AddFixed(const SampleHeader& header);
  void AddColor(Source source, const MeshAttribute& column);
  void AddCarried(Source source, const MeshAttribute& column);

  std::vector<VdbAttribute> attributes_;
  std::vector<Source> sources_;  // Of each.
};

}  // namespace strata::io
