// The sample writers of the single formats; use io/sample_writer.h from outside.
#pragma once

#include <memory>
#include <string>

#include "core/samples.h"
#include "io/atomic_file.h"
#include "io/sample_writer.h"

namespace strata::io {

/// Each but the last takes over an empty output file; PLY and XYZ have what the header says written
/// at its front already when it returns. Preconditions: header.count > 0, header.provenance is one
/// line. Errors of making and writing: kIo, kOverBudget.

/// PLY, binary little endian; docs/sample-formats.md. Streams: O(1) memory.
Result<std::unique_ptr<SampleWriter>> MakePlyWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header);
/// Text, one sample a line; docs/sample-formats.md. Streams: O(1) memory.
Result<std::unique_ptr<SampleWriter>> MakeXyzWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header);
/// The same without the lines that begin with #: a line of names, then numbers with commas between.
/// What is not a number is "nan", "inf" or "-inf". Streams: O(1) memory.
Result<std::unique_ptr<SampleWriter>> MakeCsvWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header);
/// NumPy's zip of arrays; docs/sample-formats.md. Memory: 2 MiB with scratch space; the samples,
/// until Finish, without. Nothing is written before Finish.
Result<std::unique_ptr<SampleWriter>> MakeNpzWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources);
/// A binary glTF of points; docs/sample-formats.md. Memory and disk: as NPZ. kOverBudget beyond 4
/// GiB.
Result<std::unique_ptr<SampleWriter>> MakeGlbWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources);
/// An OpenVDB grid of points, made by resources.vdb_program; docs/sample-formats.md. No position
/// is read back further than header.position_error from the sample's. Memory: an eighth of what is
/// left of the account (256 MiB without a bound; all samples without scratch space) until Finish,
/// and in Finish what is left of it, the other process's included. Disk: the samples, and the
/// output. Errors: kUnsupported without the program; kOverBudget when the grid does not fit memory,
/// or header.position_error is finer than float32 offsets from a cell's middle.
Result<std::unique_ptr<SampleWriter>> MakeVdbWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources);
/// One Draco point cloud; docs/draco-output.md. No decoded position is further than
/// header.position_error from the sample's. Memory: DracoEncoderBytes in Finish, and without
/// scratch space the samples. Nothing is written before Finish.
/// Errors: kOverBudget, also when header.position_error is finer than Draco's 32-bit floats can
/// hold over header.bounds (the message names the smallest that is not), or when there are more
/// samples than Draco counts.
Result<std::unique_ptr<SampleWriter>> MakeDracoWriter(std::unique_ptr<AtomicFile> file,
                                                      const SampleHeader& header,
                                                      const WriterResources& resources);
/// A folder of Draco point clouds; docs/draco-output.md, Tiles. The header's lattice must be set.
/// Memory: DracoEncoderBytes of the largest tile in Finish, some hundred bytes a tile, and without
/// scratch space the samples.
/// With resources.tiles_in_zip a zip of the folder's files, where `path` can be no folder.
/// Errors: as MakeDracoWriter's, by tile; kInvalidArgument for a name that no folder can have.
Result<std::unique_ptr<SampleWriter>> MakeFolderWriter(const std::string& path,
                                                       const SampleHeader& header,
                                                       const WriterResources& resources);

}  // namespace strata::io
