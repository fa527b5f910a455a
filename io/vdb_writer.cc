#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "core/external_sort.h"
#include "core/version.h"
#include "io/checked_writer.h"
#include "io/format_writers.h"
#include "io/sha256.h"
#include "io/vdb_child.h"
#include "io/vdb_columns.h"

namespace strata::io {
namespace {

// What strata-vdb takes before it holds a point: OpenVDB's tables, the compressor's buffers.
constexpr std::uint64_t kProgramBytes = std::uint64_t{24} << 20;
// Samples wait for their place up to so much in memory where there is scratch space.
constexpr std::uint64_t kMostSortBytes = std::uint64_t{256} << 20;

const double kSqrt3 = std::sqrt(3.0);

double LargestCoordinate(const SampleHeader& header) {
  double largest = 0;
  for (int a = 0; a < 3; ++a) {
    largest = std::max({largest, std::abs(header.bounds.min[a]), std::abs(header.bounds.max[a]),
                        std::abs(header.lattice_origin[a])});
  }
  return largest;
}

// How far a codec may move a position along an axis, in edges. Steps are rounded to the nearest but
// for the last, which would be in the next voxel.
double StepOf(VdbCodec codec) {
  switch (codec) {
    case VdbCodec::kFixed8:
      return 1.0 / 255;
    case VdbCodec::kFixed16:
      return 1.0 / 65535;
    default:
      return 0x1p-24;
  }
}

// And in the world, with what computing in double adds.
double ErrorOf(VdbCodec codec, const SampleHeader& header) {
  return kSqrt3 * (StepOf(codec) * header.edge + LargestCoordinate(header) * 0x1p-50);
}

std::string Text(double number) {
  std::array<char, 32> text;
  std::snprintf(text.data(), text.size(), "%.3g", number);
  return text.data();
}

Result<VdbCodec> ChooseCodec(const SampleHeader& header, const std::string& name) {
  for (const VdbCodec codec : {VdbCodec::kFixed8, VdbCodec::kFixed16, VdbCodec::kFloat}) {
    if (ErrorOf(codec, header) <= header.position_error) return codec;
  }
  const double finest = ErrorOf(VdbCodec::kFloat, header);
  return Fail(ErrorCode::kOverBudget,
              name + ": a position error of " + Text(header.position_error / header.edge) +
                  " edges is finer than a vdb's float32 offsets hold; the smallest is " +
                  Text(1.01 * finest / header.edge) + " (ply, xyz and npz are exact)");
}

// OpenVDB takes a transform whose determinant is below 3e-15 for one that cannot be inverted.
Result<void> CheckEdge(const SampleHeader& header, const std::string& name) {
  if (header.edge * header.edge * header.edge >= 3e-15) return {};
  return Fail(ErrorCode::kOverBudget,
              name + ": cells with an edge of " + Text(header.edge) +
                  " are too small for a vdb, whose transforms begin at 1.45e-05; scale the mesh " +
                  "(metres to millimetres), or use ply, npz or drc");
}

// The voxel of each sample, and where in it: the cell that drew the sample, or where it lies
// outside of that (subdivide) the cell in which it lies.
class VoxelPlaces {
 public:
  explicit VoxelPlaces(const SampleHeader& header)
      : origin_(header.lattice_origin),
        edge_(header.edge),
        slack_(LargestCoordinate(header) / header.edge * 0x1p-50 + 0x1p-40) {}

  // `cell` may be null. False if the voxel has no number of 32 bits.
  bool Place(Vec3 position, const Cell* cell, VdbPlace& place) const {
    const Vec3 from_origin = position - origin_;
    const Vec3 in_cells{from_origin.x / edge_, from_origin.y / edge_, from_origin.z / edge_};
    std::array<double, 3> voxel;
    for (std::size_t a = 0; a < 3; ++a) voxel[a] = std::floor(in_cells[static_cast<int>(a)]);
    if (cell != nullptr && Holds(*cell, in_cells)) {
      voxel = {static_cast<double>(cell->x), static_cast<double>(cell->y),
               static_cast<double>(cell->z)};
    }
    for (std::size_t a = 0; a < 3; ++a) {
      if (!(std::abs(voxel[a]) < kMostVoxel)) return false;
      place.voxel[a] = static_cast<std::int32_t>(voxel[a]);
      const double offset = in_cells[static_cast<int>(a)] - voxel[a] - 0.5;
      place.position[a] = std::clamp(static_cast<float>(offset), -0.5f, kBelowHalf);
    }
    return true;
  }

 private:
  static constexpr double kMostVoxel = 0x1p+30 + 8;
  static constexpr float kBelowHalf = 0.5f - 0x1p-25f;

  bool Holds(const Cell& cell, const Vec3& in_cells) const {
    const double corner[] = {static_cast<double>(cell.x), static_cast<double>(cell.y),
                             static_cast<double>(cell.z)};
    for (int a = 0; a < 3; ++a) {
      const double offset = in_cells[a] - corner[a];
      if (offset < -slack_ || offset > 1 + slack_) return false;
    }
    return true;
  }

  Vec3 origin_;
  double edge_, slack_;
};

// A leaf's number within the box of all leaves: equal for equal leaves alone.
class LeafNumbers {
 public:
  // Errors: kOverBudget when 64 bits are too few.
  static Result<LeafNumbers> Of(const SampleHeader& header, const std::string& name) {
    LeafNumbers numbers;
    int bits = 0;
    for (int a = 0; a < 3; ++a) {
      const auto in_leaves = [&](double world) {
        return std::floor((world - header.lattice_origin[a]) / header.edge / 8);
      };
      // One more on each side, as a sample on a face may be either cell's.
      const double first = in_leaves(header.bounds.min[a]) - 1;
      const double last = in_leaves(header.bounds.max[a]) + 1;
      if (!(first > -0x1p+29 && last < 0x1p+29)) return TooWide(name);
      const auto k = static_cast<std::size_t>(a);
      numbers.first_[k] = static_cast<std::int64_t>(first);
      numbers.bits_[k] = static_cast<int>(std::bit_width(static_cast<std::uint64_t>(last - first)));
      bits += numbers.bits_[k];
    }
    if (bits > 64) return TooWide(name);
    return numbers;
  }

  // False outside of the box.
  bool Number(const VdbPlace& place, std::uint64_t& number) const {
    number = 0;
    for (std::size_t a = 0; a < 3; ++a) {
      const std::int64_t leaf = (place.voxel[a] >> 3) - first_[a];
      if (leaf < 0 || leaf >> bits_[a] != 0) return false;
      number = number << bits_[a] | static_cast<std::uint64_t>(leaf);
    }
    return true;
  }

 private:
  static tl::unexpected<Error> TooWide(const std::string& name) {
    return Fail(ErrorCode::kOverBudget,
                name +
                    ": the samples lie further apart than a vdb is written for: 2^64 leaves of "
                    "8^3 cells; use ply, npz or drc");
  }
  std::array<std::int64_t, 3> first_{};
  std::array<int, 3> bits_{};
};

// OpenVDB draws one at random; this one depends on what the file holds.
std::string UuidFor(const SampleHeader& header, const VdbHead& head) {
  std::string text =
      std::to_string(header.count) + " " + std::to_string(static_cast<int>(head.codec));
  for (const auto& [key, value] : head.metadata) text += "\n" + key + " " + value;
  std::string hex = Sha256Hex(text).substr(0, 32);
  if (hex.size() != 32) hex.assign(32, '0');
  hex[12] = '8';  // "Made in the maker's own way", RFC 9562; the variant's bits are 10.
  hex[16] = "89ab"[(hex[16] >= 'a' ? hex[16] - 'a' + 10 : hex[16] - '0') & 3];
  for (const std::size_t dash : {20, 16, 12, 8}) hex.insert(dash, 1, '-');
  return hex;
}

// Samples are sorted by leaf on their way; strata-vdb makes the grid and fills a scratch file,
// which then becomes the output.
class VdbWriter final : public FileWriter {
 public:
  VdbWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header,
            const WriterResources& resources, VdbCodec codec, const LeafNumbers& leaves)
      : FileWriter(std::move(file), header),
        resources_(resources),
        codec_(codec),
        columns_(header),
        places_(header),
        leaves_(leaves),
        row_(sizeof(std::uint64_t) + VdbRowBytes(columns_.attributes())) {}

  Result<void> Prepare() {
    const std::uint64_t record = row_.size();
    // What ExternalSort keeps of each beside it.
    const std::uint64_t all = header().count * (record + 16) + ExternalSort::kLeastBytes;
    if (header().count > kMostPoints || all / record < header().count) {
      return Fail(ErrorCode::kOverBudget, name() + ": " + std::to_string(header().count) +
                                              " samples are more than a vdb is written for");
    }
    std::uint64_t bytes = all;
    if (resources_.scratch != nullptr) {
      bytes = std::min(bytes, kMostSortBytes);
      if (resources_.memory != nullptr) bytes = std::min(bytes, resources_.memory->left() / 8);
    }
    bytes = std::max(bytes, ExternalSort::kLeastBytes);
    if (resources_.memory != nullptr) {
      auto share = resources_.memory->Take(bytes, name() + ": the samples");
      if (!share) return Forward(share);
      sort_share_ = std::move(*share);
    }
    sort_context_.SetScratch(resources_.scratch);
    auto sort = ExternalSort::Open(record, bytes, "the samples", sort_context_);
    if (!sort) return Forward(sort);
    sort_ = std::move(*sort);
    return {};
  }

 protected:
  Result<void> Append(const SampleColumns& columns) override try {
    if (cancelled()) return Cancelled();
    for (std::size_t i = 0; i < columns.size(); ++i) {
      VdbPlace place;
      std::uint64_t leaf = 0;
      const Cell* const cell = columns.cell.empty() ? nullptr : &columns.cell[i];
      if (!places_.Place(columns.position[i], cell, place) || !leaves_.Number(place, leaf)) {
        return Fail(ErrorCode::kInternal, name() + ": a sample lies outside the header's bounds");
      }
      std::memcpy(row_.data(), &leaf, sizeof leaf);
      std::memcpy(row_.data() + sizeof leaf, &place, sizeof place);
      columns_.Pack(columns, i, row_.data() + sizeof leaf + sizeof place);
      if (auto added = sort_->Add(row_.data()); !added) return added;
    }
    return {};
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, name() + ": out of memory");
  }

  Result<std::uint64_t> Complete() override try {
    if (cancelled()) return Cancelled();
    if (auto sorted = sort_->Sort(); !sorted) return Forward(sorted);
    auto grid = OpenGridFile();
    if (!grid) return Forward(grid);
    auto head = Head();
    if (!head) return Forward(head);
    std::uint64_t bytes = 0;
    {
      VdbChild child(name(), resources_.context);
      auto sent = child.Start(resources_.vdb_program, std::move(*head), **grid);
      if (sent) sent = SendAll(child);
      if (!sent) return Forward(sent);
      const auto done = child.Finish();
      if (!done) return Forward(done);
      bytes = *done;
    }
    grid_share_ = MemoryShare();
    if (auto copied = Copy(**grid, bytes); !copied) return Forward(copied);
    return file().Finish();
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, name() + ": out of memory");
  }

 private:
  // Offsets and lengths of a leaf's points are 32-bit numbers; a stride multiplies them.
  static constexpr std::uint64_t kMostPoints = 0xffff'ffff / kMostComponents;

  bool cancelled() const {
    return resources_.context != nullptr && resources_.context->cancelled();
  }

  Result<std::unique_ptr<ScratchFile>> OpenGridFile() {
    if (resources_.scratch != nullptr) return resources_.scratch->NewFile();
    const int fd = memfd_create("strata-vdb", MFD_CLOEXEC);
    if (fd >= 0) return std::make_unique<ScratchFile>(fd, "in memory");
    return Fail(ErrorCode::kIo,
                name() + ": a file in memory: " + std::generic_category().message(errno));
  }

  // All that is left is the grid's: nothing of the job comes after it.
  Result<VdbHead> Head() {
    VdbHead head;
    if (resources_.memory != nullptr && resources_.memory->limited()) {
      const std::uint64_t left = std::max(resources_.memory->left(), 2 * kProgramBytes);
      auto share = resources_.memory->Take(left, name() + ": OpenVDB's nodes");
      if (!share) return Forward(share);
      grid_share_ = std::move(*share);
      head.memory_bytes = left - kProgramBytes;
      // The file is in memory, too, and no larger than the grid.
      if (resources_.scratch == nullptr) head.memory_bytes /= 2;
    }
    const Vec3 origin = header().lattice_origin;
    const double half = header().edge / 2;
    head.edge = header().edge;
    head.first_voxel = {origin.x + half, origin.y + half, origin.z + half};
    head.count = header().count;
    head.codec = codec_;
    head.creator = "strata " + std::string(kVersion);
    head.attributes = columns_.attributes();
    head.metadata = columns_.Metadata(header());
    head.uuid = UuidFor(header(), head);
    return head;
  }

  Result<void> SendAll(VdbChild& child) {
    for (;;) {
      const auto record = sort_->Next();
      if (!record) return Forward(record);
      if (*record == nullptr) break;
      const std::span<const char> row(*record + sizeof(std::uint64_t),
                                      row_.size() - sizeof(std::uint64_t));
      if (auto sent = child.Send(row); !sent) return sent;
    }
    sort_.reset();
    return {};
  }

  Result<void> Copy(const ScratchFile& grid, std::uint64_t bytes) {
    std::vector<char> portion(std::size_t{1} << 18);
    for (std::uint64_t done = 0; done < bytes;) {
      if (cancelled()) return Cancelled();
      const std::uint64_t n = std::min<std::uint64_t>(portion.size(), bytes - done);
      const std::span<char> part(portion.data(), n);
      if (auto read = grid.ReadAt(done, part); !read) return read;
      if (auto written = file().Write({part.data(), part.size()}); !written) return written;
      done += n;
    }
    return {};
  }

  const WriterResources resources_;
  const VdbCodec codec_;
  const VdbColumns columns_;
  const VoxelPlaces places_;
  const LeafNumbers leaves_;
  RunContext sort_context_;  // The sorter's own: its memory is taken from the job's account above.
  MemoryShare sort_share_, grid_share_;
  std::unique_ptr<ExternalSort> sort_;
  std::vector<char> row_;
};

}  // namespace

Result<void> CheckVdbProgram(const std::string& program) {
  if (!program.empty() && access(program.c_str(), X_OK) == 0) return {};
  return Fail(ErrorCode::kUnsupported,
              "vdb needs the program strata-vdb, " +
                  (program.empty() ? "which nobody named" : "which is not there: " + program));
}

Result<std::unique_ptr<SampleWriter>> MakeVdbWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources) {
  const std::string name = file->name();
  if (auto found = CheckVdbProgram(resources.vdb_program); !found) {
    return Fail(found.error().code, name + ": " + found.error().message);
  }
  if (auto large_enough = CheckEdge(header, name); !large_enough) return Forward(large_enough);
  const auto codec = ChooseCodec(header, name);
  if (!codec) return Forward(codec);
  const auto leaves = LeafNumbers::Of(header, name);
  if (!leaves) return Forward(leaves);
  auto writer = std::make_unique<VdbWriter>(std::move(file), header, resources, *codec, *leaves);
  if (auto prepared = writer->Prepare(); !prepared) return Forward(prepared);
  return writer;
}

}  // namespace strata::io
