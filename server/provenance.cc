#include "server/provenance.h"

#include "core/version.h"
#include "server/json_parts.h"

namespace strata::server {

std::string Provenance(const SampleOptions& options, double position_error,
                       const SampleStats& stats) {
  Json json = {{"program", "strata"}, {"version", kVersion}, {"surface_hash", stats.surface_hash}};
  json.update(OptionsToJson(options, position_error, stats));
  json["lattice"] = LatticeToJson(options.lattice, stats.lattice);
  return json.dump();
}

}  // namespace strata::server
