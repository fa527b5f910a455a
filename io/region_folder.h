// A folder of tiles that several processes, perhaps on several machines, write together.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/parcels.h"
#include "core/result.h"
#include "core/samples.h"
#include "io/sample_writer.h"

namespace strata::io {

/// What all processes of a shared output have in common, and which of its regions one of them
/// writes.
struct SharedOutput {
  std::string path;     ///< Of the folder that shall appear.
  SampleHeader header;  ///< Its count is left aside.
  std::uint64_t tile_samples = kDefaultTileSamples;
  std::string mesh;  ///< Which file the samples are of, for telling outputs apart.
  Region region;
};

/// Until the last region is there, `PATH.regions` holds a file that says which output is under way,
/// the tiles so far, and a fragment of the manifest for every region that is done. The process that
/// finds all fragments puts the manifest together, gives the tiles' folder its final name, in place
/// of what had it as AtomicFolder does, and removes the rest. Any number may do so at once; who
/// comes too late finds the output there. Nothing but names tells the state: a process may be
/// killed at any point, and the next one of the same output goes on from there. The result is
/// the folder that a single writer makes, byte for byte. docs/draco-output.md, Regions.
///
/// Threads: one at a time; any number of processes.
class RegionFolder {
 public:
  /// Errors: kInvalidArgument when another output is under way there, naming what differs, or when
  /// the final name may not be taken; kIo.
  static Result<std::unique_ptr<RegionFolder>> Open(const SharedOutput& output);
  ~RegionFolder();
  RegionFolder(const RegionFolder&) = delete;
  RegionFolder& operator=(const RegionFolder&) = delete;

  /// Whether the output stands under its final name: a folder whose manifest begins as this one's.
  bool IsFinished() const;
  /// Whether the region's tiles and its fragment are there.
  bool IsRegionDone() const;

  /// Takes the region's samples: header.count of `header`, at least one, in header.parcels.
  /// Finish leaves the fragment. Neither may outlive this. Errors: as OpenSampleWriter.
  Result<std::unique_ptr<SampleWriter>> Write(const SampleHeader& header,
                                              const WriterResources& resources);
  /// Leaves the fragment of a region without samples.
  Result<void> WriteNothing();

  /// Publishes the output if every region is there. Returns how many are. Errors: kIo,
  /// kCorruptInput (a fragment that somebody changed).
  Result<std::uint32_t> Commit();

 private:
  class Place;

  explicit RegionFolder(const SharedOutput& output) : output_(output) {}
  Result<void> Start();
  Result<bool> TryToOpenWork();
  Result<void> CreateWork();
  Result<void> CheckJob() const;
  Result<std::string> Manifest() const;
  std::uint32_t FragmentCount() const;
  Result<bool> TryToPublish();
  bool Claim(const std::string& claim) const;
  bool IsOurs(const std::string& claim) const;
  void RemoveWork();
  void GiveWorkAway();
  Result<void> PutFile(const std::string& name, std::string_view bytes) const;
  Result<void> PutTile(const std::string& path, std::string_view bytes) const;
  Result<std::uint64_t> PutFragment(std::uint64_t samples,
                                    const std::vector<std::string>& entries) const;
  tl::unexpected<Error> FailIo(const std::string& what, int error) const;

  SharedOutput output_;
  std::string head_, job_;         // Of the manifest; what all processes must agree on.
  std::string final_name_, work_;  // Within parent_.
  int parent_ = -1, folder_ = -1;  // folder_: the one named work_, wherever it has come to stand.
};

}  // namespace strata::io
