// The summary of a job, for programs (JSON) and for people (a few lines).
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/partial.h"
#include "core/sample_mesh.h"
#include "core/summarize_mesh.h"
#include "server/attribute_ranges.h"
#include "server/command_line.h"

namespace strata::server {

/// What the command itself measured around SampleMesh. Wall seconds; bytes as stored.
struct JobFigures {
  MeshInfo mesh;
  std::vector<MeshAttribute> carried;  ///< The columns that the mesh's attributes became.
  double open_seconds = 0, write_seconds = 0, picture_seconds = 0, total_seconds = 0;
  std::uint64_t open_bytes = 0;   ///< Read of the input before its first triangle.
  std::uint64_t scan_bytes = 0;   ///< Read of the input in one pass over its triangles.
  std::uint64_t write_bytes = 0;  ///< Size of the output.
  int threads = 0;                ///< Workers the job could use.
};

/// The JSON of `--summary`, indented, with a line end.
std::string SummaryJson(const SampleCommand& command, const SampleStats& stats,
                        const JobFigures& figures);
/// The lines a person sees on standard error.
std::string SummaryText(const SampleCommand& command, const SampleStats& stats,
                        const JobFigures& figures);

/// What a person sees of a partial that was written.
std::string PartialText(const std::string& output, const PartialInfo& info, std::uint64_t bytes);

/// `strata info --json`, indented, with a line end.
std::string InfoJson(const MeshInfo& info, const MeshSummary& summary,
                     const std::vector<AttributeRange>& attributes = {},
                     const std::vector<MeshTexture>& textures = {});
/// `strata info`.
std::string InfoText(const MeshInfo& info, const MeshSummary& summary,
                     const std::vector<AttributeRange>& attributes = {},
                     const std::vector<MeshTexture>& textures = {});

}  // namespace strata::server
