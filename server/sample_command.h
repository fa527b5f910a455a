// `strata sample`, `strata scan` and `strata merge`: open, sample, write.
#pragma once

#include "core/result.h"
#include "core/run_context.h"
#include "server/command_line.h"
#include "server/summary_json.h"

namespace strata::server {

/// What a job came to.
struct JobReport {
  SampleStats stats;
  JobFigures figures;
};

/// Runs one job from file to file. Progress and a summary for people go to standard error, unless
/// `quiet`; nothing else is printed except what the command names "-".
///
/// Places that can never be written are refused before the input is read. After an error no output
/// of this job stands under its name, unless the error concerns an output written after it: samples
/// first, then the picture, then the summary.
/// Errors: kInvalidArgument (two places are the same file, unknown --simd), those of
/// OpenMesh, SampleMesh and SampleWriter.
/// `report`, if it is given, is filled when all went well.
Result<void> RunSample(const SampleCommand& command, RunContext& context,
                       JobReport* report = nullptr);

/// Scans one share of a mesh into a partial. Errors: as RunSample.
Result<void> RunScan(const ScanCommand& command, RunContext& context);

/// Merges partials: into samples when all shares are there, or into one partial.
/// Errors: as RunSample; those of CombinePartials and WholeOf.
Result<void> RunMerge(const MergeCommand& command, RunContext& context);

}  // namespace strata::server
