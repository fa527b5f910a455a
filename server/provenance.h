// What every output carries, so that its samples can be drawn again.
#pragma once

#include <string>

#include "core/sample_mesh.h"

namespace strata::server {

/// One line of JSON without a line end: version, surface hash, the options that decide the samples,
/// seed, lattice. The keys' order is fixed and each number is the shortest text that reads back as
/// the same double.
///
/// Nothing of the file that carried the surface, of the run (threads, batch size, time) or of the
/// output's format is in it: equal surfaces, options and seeds give equal bytes (promise 3).
/// `position_error` is a fraction of the edge.
std::string Provenance(const SampleOptions& options, double position_error,
                       const SampleStats& stats);

}  // namespace strata::server
