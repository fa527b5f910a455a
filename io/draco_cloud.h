// Samples as one Draco point cloud in memory: docs/draco-output.md.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/samples.h"
#include "io/float_grid.h"
#include "io/sample_rows.h"

namespace strata::io {

/// What EncodeDracoCloud takes of memory for `count` samples on a grid of `position_bits`, at most:
/// measured, and rounded up.
std::uint64_t DracoEncoderBytes(AttributeSet attributes, std::uint64_t count, int position_bits);
/// The same with the header's carried columns.
std::uint64_t DracoEncoderBytes(const SampleHeader& header, std::uint64_t count, int position_bits);

/// Encodes all of `rows`, in their order, to Draco bitstream 2.3 as docs/draco-output.md sets out.
/// `grid` must hold every position (ChooseFloatGrid or TileGrid). Of the header it takes
/// attributes, edge, position_error and provenance. Reads the rows once per attribute, and once to
/// hold the decoded positions against them.
///
/// Errors: kOverBudget when cells lie too far apart for Draco or memory runs out; kInternal when
/// Draco does not give back what was encoded; those of the rows. `name` begins the messages.
Result<std::vector<char>> EncodeDracoCloud(const RowReader& rows, const FloatGrid& grid,
                                           const SampleHeader& header, const std::string& name);

}  // namespace strata::io
