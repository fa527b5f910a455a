#include "io/obj_materials.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "io/companion_file.h"
#include "io/decimal.h"
#include "io/quote.h"
#include "io/srgb.h"
#include "io/text_scanner.h"

namespace strata::io {
namespace {

constexpr std::size_t kMostLibraries = 64, kMostMaterials = 65536;
// So many image files are held open at once.
constexpr std::size_t kMostOpen = 64;

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

// Keywords are written in capitals or not.
bool IsWord(std::string_view found, std::string_view lower) {
  const auto small = [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; };
  return std::equal(found.begin(), found.end(), lower.begin(), lower.end(),
                    [&](char a, char b) { return small(a) == b; });
}

std::optional<double> NumberOf(std::string_view word) {
  double number = 0;
  const char* const end = ParseDecimal(word.data(), word.data() + word.size(), number);
  if (word.empty() || end != word.data() + word.size() || !std::isfinite(number)) return {};
  return number;
}

// A map's file behind its options ("-s 1 1 1 -clamp on name.png"): what no option takes. Those that
// say where the image lies are kept, others are passed over.
void ReadMap(std::string_view rest, ObjMaterial& material) {
  material.clamp = false;
  material.offset = {0, 0};
  material.scale = {1, 1};
  while (rest.starts_with('-')) {
    auto [option, values] = Split(rest);
    const bool vector = option == "-o" || option == "-s" || option == "-t";
    const std::size_t most = vector ? 3 : option == "-mm" ? 2 : 1;
    for (std::size_t i = 0; i < most; ++i) {
      const auto [value, after] = Split(values);
      const auto number = NumberOf(value);
      if (i > 0 && !number) break;
      if (option == "-clamp") material.clamp = value == "on";
      if (number && i < 2 && option == "-o") material.offset[i] = *number;
      if (number && i < 2 && option == "-s") material.scale[i] = *number;
      values = after;
    }
    rest = values;
  }
  material.color_map = std::string(rest);
}

// One number stands for three. What is given in another way (spectral, xyz) is left out.
void ReadDiffuse(std::string_view rest, ObjMaterial& material) {
  std::array<double, 3> diffuse{};
  for (std::size_t k = 0; k < 3; ++k) {
    const auto [word, after] = Split(rest);
    const auto number = NumberOf(word);
    if (!number && (k == 0 || !word.empty())) return;
    diffuse[k] = number ? std::clamp(*number, 0.0, 1.0) : diffuse[0];
    rest = after;
  }
  material.diffuse = diffuse;
}

// A name in quotes, as some exporters write those with blanks, without them; "" of any other.
// Before it may stand the folder of its library.
std::string WithoutQuotes(const std::string& name) {
  const std::size_t open = name.find('"');
  const bool whole = open != std::string::npos && open + 2 < name.size() &&
                     name.find('"', open + 1) == name.size() - 1 &&
                     (open == 0 || name[open - 1] == '/' || name[open - 1] == '\\');
  return whole ? name.substr(0, open) + name.substr(open + 1, name.size() - open - 2) : "";
}

struct NamedFile {
  std::unique_ptr<ByteSource> source;
  std::string name;  // As it was found.
};

// What a name names as it stands; where there is no such file, without its quotes.
Result<NamedFile> OpenNamed(const std::shared_ptr<const CompanionFiles>& companions,
                            const std::string& name, const std::string& who) {
  const auto path = RelativePathOfName(name, who);
  if (!path) return Forward(path);
  auto source = OpenCompanion(companions, *path, who);
  if (source) return NamedFile{*std::move(source), name};
  const std::string bare = WithoutQuotes(name);
  if (bare.empty() || source.error().code != ErrorCode::kNotFound) return Forward(source);
  return OpenNamed(companions, bare, who);
}

// A path in a library is relative to that.
std::string MapPath(const ObjMaterial& material) {
  const std::size_t slash = material.library.find_last_of("/\\");
  const std::string bare = WithoutQuotes(material.color_map);
  const std::string& map = bare.empty() ? material.color_map : bare;
  const bool rooted =
      map.starts_with('/') || map.starts_with('\\') || map.find(':') != std::string::npos;
  if (slash == std::string::npos || rooted) return material.color_map;
  return material.library.substr(0, slash + 1) + material.color_map;
}

BaseColor ColorOf(const ObjMaterial& material) {
  BaseColor color;
  for (std::size_t k = 0; k < 3; ++k) color.factor[k] = LinearOfSrgb(material.diffuse[k]);
  const Wrap wrap = material.clamp ? Wrap::kClamp : Wrap::kRepeat;
  color.sampler = {wrap, wrap, false};
  // Images begin at the top, an OBJ's coordinates at the bottom.
  const auto [su, sv] = material.scale;
  const auto [ou, ov] = material.offset;
  color.transform.m = {su, 0, ou, 0, -sv, 1 - ov};
  return color;
}

}  // namespace

std::string FileImages::NameOf(std::uint32_t image) const {
  return who_ + ": the image " + Quoted(paths_[image]);
}

Result<ImageFile> FileImages::Read(std::uint32_t image, std::uint64_t most, MemoryAccount* memory) {
  auto found = open_.find(image);
  if (found == open_.end()) {
    auto file = OpenNamed(companions_, paths_[image], who_);
    if (!file) return Forward(file);
    if (open_.size() >= kMostOpen) open_.erase(open_.begin());
    found = open_.emplace(image, std::move(file->source)).first;
  }
  ByteSource& source = *found->second;
  return ReadImageFile(source.size().value_or(0), most, memory, NameOf(image) + ": its bytes",
                       [&](std::span<char> out) { return source.ReadAt(0, out); });
}

bool ObjColors::textured() const {
  return std::any_of(materials.begin(), materials.end(), [](const BaseColor& color) {
    return color.image.has_value() || color.fault.has_value();
  });
}

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
      if (!fault_) fault_ = ok.error();
    }
  }
  return {};
}

Result<void> ObjMaterials::LoadOne(const std::string& library, const std::string& who,
                                   const OpenOptions& options) {
  const auto file = OpenNamed(options.companions, library, who);
  if (!file) return Forward(file);
  TextScanner text(*file->source, options.max_line_bytes);
  while (text.Next()) {
    const auto [keyword, rest] = Split(text.line());
    if (keyword == "newmtl") {
      if (materials_.size() == kMostMaterials) break;
      materials_.push_back({std::string(rest), file->name});
    } else if (IsWord(keyword, "map_kd") && !materials_.empty()) {
      ReadMap(rest, materials_.back());
    } else if (IsWord(keyword, "kd") && !materials_.empty()) {
      ReadDiffuse(rest, materials_.back());
    }
  }
  return text.failed() ? Result<void>(text.failure()) : Result<void>();
}

ObjColors ObjMaterials::ColorsOf(const std::vector<std::string>& names, const std::string& who,
                                 const OpenOptions& options) const {
  std::map<std::string_view, const ObjMaterial*> by_name;
  for (const ObjMaterial& material : materials_) by_name.emplace(material.name, &material);
  ObjColors colors;
  std::vector<std::string> paths;
  std::map<std::string, std::uint32_t> numbers;
  for (std::size_t k = 0; k < names.size(); ++k) {
    BaseColor& color = colors.materials.emplace_back();
    const auto found = by_name.find(names[k]);
    if (found == by_name.end()) {
      // The first may be the name of those that have none.
      if (k > 0) color.fault = fault_;
      continue;
    }
    color = ColorOf(*found->second);
    if (found->second->color_map.empty()) continue;
    const auto [number, fresh] =
        numbers.try_emplace(MapPath(*found->second), static_cast<std::uint32_t>(paths.size()));
    if (fresh) paths.push_back(number->first);
    color.image = number->second;
  }
  colors.images = std::make_unique<FileImages>(who, std::move(paths), options);
  return colors;
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
