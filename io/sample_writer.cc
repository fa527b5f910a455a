#include "io/sample_writer.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <utility>

#include "io/atomic_file.h"
#include "io/format_writers.h"

namespace strata::io {
namespace {

constexpr std::array<std::pair<std::string_view, SampleFormat>, 7> kFormats = {
    {{"drc", SampleFormat::kDraco},
     {"ply", SampleFormat::kPly},
     {"xyz", SampleFormat::kXyz},
     {"npz", SampleFormat::kNpz},
     {"csv", SampleFormat::kCsv},
     {"glb", SampleFormat::kGlb},
     {"vdb", SampleFormat::kVdb}}};

Result<void> CheckHeader(const std::string& path, const SampleHeader& header) {
  const auto fail = [&](ErrorCode code, const char* what) {
    return Fail(code, path + ": " + what);
  };
  if (header.count == 0) return fail(ErrorCode::kEmptySurface, "there is no sample to write");
  if ((header.attributes & ~kAllAttributes) != 0) {
    return fail(ErrorCode::kInvalidArgument, "unknown attributes were asked for");
  }
  for (const MeshAttribute& column : header.carried) {
    if (column.components >= 1 && column.components <= kMostComponents) continue;
    return fail(ErrorCode::kInternal, "a carried column has no or too many components");
  }
  if (header.provenance.find_first_of(std::string_view("\r\n\0", 3)) != std::string::npos) {
    return fail(ErrorCode::kInternal, "the provenance is not one line");
  }
  return {};
}

}  // namespace

std::optional<SampleFormat> SampleFormatFromName(std::string_view name) {
  for (const auto& [known, format] : kFormats) {
    if (name == known) return format;
  }
  return std::nullopt;
}

std::optional<SampleFormat> SampleFormatFromPath(std::string_view path) {
  const std::size_t dot = path.rfind('.');
  const std::size_t slash = path.rfind('/');
  if (dot == std::string_view::npos || (slash != std::string_view::npos && dot < slash)) {
    return std::nullopt;
  }
  std::string suffix(path.substr(dot + 1));
  std::transform(suffix.begin(), suffix.end(), suffix.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return SampleFormatFromName(suffix);
}

Result<std::unique_ptr<SampleWriter>> OpenSampleWriter(const std::string& path, SampleFormat format,
                                                       const SampleHeader& header,
                                                       const WriterResources& resources) {
  if (auto checked = CheckHeader(path, header); !checked) return Forward(checked);
  if (format == SampleFormat::kDraco && header.count > resources.tile_samples) {
    return MakeFolderWriter(path, header, resources);
  }
  // Fewer samples than last time may make a file of what was a folder of tiles.
  auto file = AtomicFile::Open(path, format == SampleFormat::kDraco ? kTilesetName : "");
  if (!file) return Forward(file);
  switch (format) {
    case SampleFormat::kDraco:
      return MakeDracoWriter(std::move(*file), header, resources);
    case SampleFormat::kPly:
      return MakePlyWriter(std::move(*file), header);
    case SampleFormat::kXyz:
      return MakeXyzWriter(std::move(*file), header);
    case SampleFormat::kCsv:
      return MakeCsvWriter(std::move(*file), header);
    case SampleFormat::kGlb:
      return MakeGlbWriter(std::move(*file), header, resources);
    case SampleFormat::kVdb:
      return MakeVdbWriter(std::move(*file), header, resources);
    case SampleFormat::kNpz:
      return MakeNpzWriter(std::move(*file), header, resources);
  }
  return Fail(ErrorCode::kInternal, path + ": unknown format");
}

}  // namespace strata::io
