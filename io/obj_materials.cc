#include "io/obj_materials.h"

#include <algorithm>
#include <utility>

#include "io/companion_file.h"
#include "io/text_scanner.h"

namespace strata::io {
namespace {

constexpr std::size_t kMostLibraries = 64, kMostMaterials = 65536;

std::string_view Trimmed(std::string_view text) {
  while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
  while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
  return text;
}

// The word that the line starts with, and what follows.
std::pair<std::string_view, std::string_view> Split(std::string_view line) {
  line = Trimmed(line);
  const auto blank = std::find_if(line.begin(), line.end(), IsBlank);
  const auto length = static_cast<std::size_t>(blank - line.begin());
  return {line.substr(0, length), Trimmed(line.substr(length))};
}

// A map's file behind its options ("-s 1 1 1 -clamp on name.png"): what no option takes.
std::string_view MapFile(std::string_view rest) {
  while (rest.starts_with('-')) {
    auto [option, values] = Split(rest);
    const bool vector = option == "-o" || option == "-s" || option == "-t";
    const int most = vector ? 3 : option == "-mm" ? 2 : 1;
    for (int i = 0; i < most; ++i) {
      const auto [value, after] = Split(values);
      const bool number =
          !value.empty() && value.find_first_not_of("+-.0123456789eE") == value.npos;
      if (i > 0 && !number) break;
      values = after;
    }
    rest = values;
  }
  return rest;
}

}  // namespace

void ObjMaterials::AddLibrary(std::string_view rest) {
  const std::string name(Trimmed(rest));
  const bool known = std::find(libraries_.begin(), libraries_.end(), name) != libraries_.end();
  if (name.empty() || known) return;
  if (libraries_.size() == kMostLibraries) {
    ++left_out_;
  } else {
    libraries_.push_back(name);
  }
}

Result<void> ObjMaterials::Load(const std::string& who, const OpenOptions& options) {
  for (const std::string& library : libraries_) {
    if (auto ok = LoadOne(library, who, options); !ok) {
      if (ok.error().code == ErrorCode::kIo) return ok;
      ++left_out_;
    }
  }
  return {};
}

Result<void> ObjMaterials::LoadOne(const std::string& library, const std::string& who,
                                   const OpenOptions& options) {
  const auto path = RelativePathOfName(library, who);
  if (!path) return Forward(path);
  auto source = OpenCompanion(options.companions, *path, who);
  if (!source) return Forward(source);
  TextScanner text(**source, options.max_line_bytes);
  while (text.Next()) {
    const auto [keyword, rest] = Split(text.line());
    if (keyword == "newmtl") {
      if (materials_.size() == kMostMaterials) break;
      materials_.push_back({std::string(rest), ""});
    } else if (keyword == "map_Kd" && !materials_.empty()) {
      materials_.back().color_map = std::string(MapFile(rest));
    }
  }
  return text.failed() ? Result<void>(text.failure()) : Result<void>();
}

void ObjMaterials::Describe(MeshContents& contents) const {
  for (const ObjMaterial& material : materials_) {
    contents.materials.push_back(material.name);
    const std::string& map = material.color_map;
    const bool known = std::find(contents.textures.begin(), contents.textures.end(), map) !=
                       contents.textures.end();
    if (!map.empty() && !known) contents.textures.push_back(map);
  }
  if (left_out_ > 0) contents.passed_over.emplace_back("material libraries not read", left_out_);
}

}  // namespace strata::io
