#include "io/ply_attributes.h"

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

#include "io/indexed_attributes.h"
#include "io/ply_values.h"

namespace strata::io {
namespace {

constexpr std::size_t kWindowBytes = std::size_t{1} << 18;

// --- Which there are --------------------------------------------------------------------------

using Names = std::vector<std::string_view>;

bool IsSurface(const PlyElement& element) {
  return element.count > 0 && (element.name == "face" || element.name == "tristrips");
}

std::size_t IndicesOf(const PlyElement& faces) {
  return faces.Find("vertex_indices", "vertex_index").value_or(faces.properties.size());
}

// Whether an element has rows with lists, that of the corners aside.
bool HasMoreLists(const PlyElement& element, std::size_t but) {
  if (element.count == 0) return false;
  for (std::size_t i = 0; i < element.properties.size(); ++i) {
    if (element.properties[i].is_list && i != but) return true;
  }
  return false;
}

// The lists' lengths in an element's first row; zeros without lists that matter, or where the row
// cannot be read.
Result<std::vector<std::uint64_t>> ListLengths(ByteSource& source, const PlyHeader& header,
                                               const PlyElement& element, const PlyMark& mark,
                                               std::size_t but) {
  std::vector<std::uint64_t> lengths(element.properties.size());
  if (!HasMoreLists(element, but)) return lengths;
  InputBuffer input(source, kWindowBytes);
  const auto values = OpenPlyValues(input, header);
  input.Forget();
  if (auto ok = values->Seek(mark); !ok) return Forward(ok);
  std::vector<std::uint64_t> none(lengths.size());
  if (!values->BeginRow(element, element.count)) return none;
  for (std::size_t i = 0; i < lengths.size(); ++i) {
    const PlyProperty& p = element.properties[i];
    std::uint64_t n = 1;
    if (p.is_list && !values->Length(p.count_type, n)) return none;
    if (!values->Skip(p.type, n)) return none;
    lengths[i] = n;
  }
  return lengths;
}

class Finder {
 public:
  Finder(const PlyElement& element, bool of_faces, std::vector<std::uint64_t> lengths,
         std::vector<PlyAttribute>& found)
      : element_(element),
        of_faces_(of_faces),
        lengths_(std::move(lengths)),
        used_(element.properties.size()),
        found_(found) {}

  void Use(std::size_t property) {
    if (property < used_.size()) used_[property] = true;
  }

  void Find() {
    Group({"red", "green", "blue"}, "alpha", "color", Semantic::kColor);
    Group({"diffuse_red", "diffuse_green", "diffuse_blue"}, "diffuse_alpha", "color",
          Semantic::kColor);
    if (!of_faces_) {
      Group({"nx", "ny", "nz"}, "", "vertex_normal", Semantic::kNormal);
      for (const Names& pair : {Names{"u", "v"}, Names{"s", "t"}, Names{"texture_u", "texture_v"},
                                Names{"texture_s", "texture_t"}}) {
        Group(pair, "", "uv", Semantic::kUv);
      }
    }
    for (std::size_t i = 0; i < used_.size(); ++i) {
      if (!used_[i]) Single(i);
    }
  }

 private:
  // Several properties of one type as one attribute, if all are there; `and_perhaps` may be.
  void Group(const Names& names, std::string_view and_perhaps, const char* as, Semantic semantic) {
    std::vector<std::size_t> properties;
    for (const std::string_view name : names) {
      const auto at = element_.Find(name);
      if (!at || used_[*at] || element_.properties[*at].is_list) return;
      if (!properties.empty() && TypeOf(*at) != TypeOf(properties[0])) return;
      properties.push_back(*at);
    }
    const PlyType type = TypeOf(properties[0]);
    const bool small = type == PlyType::kUint8 || type == PlyType::kUint16;
    if (IsInteger(type) && !(small && semantic == Semantic::kColor)) return;
    if (!and_perhaps.empty()) {
      const auto at = element_.Find(and_perhaps);
      if (at && TypeOf(*at) == type && !element_.properties[*at].is_list) properties.push_back(*at);
    }
    PlyAttribute attribute = Describe(as, type, properties);
    attribute.what.semantic = semantic;
    attribute.what.normalized = IsInteger(type);
    if (semantic == Semantic::kColor) attribute.what.color_space = ColorSpace::kSrgb;
    if (!of_faces_) attribute.what.carry = Carry::kLinear;
    Add(std::move(attribute));
  }

  void Single(std::size_t i) {
    const PlyProperty& p = element_.properties[i];
    if (!p.is_list) return Add(Describe(p.name, p.type, {i}));
    PlyAttribute attribute = Describe(p.name, p.type, {i});
    if (p.name == "texcoord" && of_faces_ && !IsInteger(p.type)) {
      attribute.what.name = "uv";
      attribute.what.components = 2;
      attribute.what.semantic = Semantic::kUv;
      attribute.what.domain = AttributeDomain::kCorner;
      attribute.what.carry = Carry::kLinear;
      attribute.wedges = true;
      return Add(std::move(attribute));
    }
    if (lengths_[i] < 1 || lengths_[i] > kMostComponents) return;
    attribute.what.components = static_cast<int>(lengths_[i]);
    Add(std::move(attribute));
  }

  PlyType TypeOf(std::size_t i) const { return element_.properties[i].type; }

  PlyAttribute Describe(std::string_view name, PlyType type,
                        const std::vector<std::size_t>& properties) const {
    PlyAttribute attribute;
    attribute.what.name = name;
    attribute.what.type = ScalarOf(type);
    attribute.what.components = static_cast<int>(properties.size());
    attribute.what.domain = of_faces_ ? AttributeDomain::kTriangle : AttributeDomain::kVertex;
    attribute.what.carry = of_faces_ ? Carry::kConstant : CarryFor(attribute.what.type, false);
    attribute.of_faces = of_faces_;
    attribute.property = properties;
    return attribute;
  }

  void Add(PlyAttribute attribute) {
    for (const std::size_t i : attribute.property) used_[i] = true;
    const auto same = [&](const PlyAttribute& other) {
      return other.what.name == attribute.what.name && !other.of_faces;
    };
    if (of_faces_ && !attribute.wedges && std::any_of(found_.begin(), found_.end(), same)) {
      attribute.what.name = "face_" + attribute.what.name;
    }
    for (const PlyAttribute& other : found_) {
      const bool counts = other.what.semantic == attribute.what.semantic &&
                          attribute.what.semantic != Semantic::kGeneric;
      attribute.what.set += counts;
    }
    found_.push_back(std::move(attribute));
  }

  const PlyElement& element_;
  const bool of_faces_;
  const std::vector<std::uint64_t> lengths_;
  std::vector<bool> used_;
  std::vector<PlyAttribute>& found_;
};

// --- Fetching ---------------------------------------------------------------------------------

// The steps of a row, and the kept row that they make.
struct RowPlan {
  std::vector<PlyStep> steps;
  std::size_t bytes = 0;
};

RowPlan PassAll(const PlyElement& element) {
  RowPlan plan;
  for (const PlyProperty& p : element.properties) plan.steps.push_back({p});
  return plan;
}

// Keeps a property, its value or its `length` items, and returns where.
std::size_t Keep(RowPlan& plan, std::size_t property, std::uint64_t length = 1) {
  PlyStep& step = plan.steps[property];
  if (step.use == PlyStep::Use::kPass) {
    step.use = PlyStep::Use::kKeep;
    step.length = length;
    step.at = plan.bytes;
    plan.bytes += static_cast<std::size_t>(length) * PlySize(step.property.type);
  }
  return step.at;
}

RowField FieldOf(const PlyAttribute& attribute, RowPlan& plan) {
  RowField field{attribute.what.type, {}, false};
  const std::size_t size = SizeOf(attribute.what.type);
  for (const std::size_t p : attribute.property) {
    const bool list = plan.steps[p].property.is_list;
    const auto n = list ? static_cast<std::size_t>(attribute.what.components) : std::size_t{1};
    const std::size_t at = Keep(plan, p, n);
    for (std::size_t k = 0; k < n; ++k) field.offset.push_back(at + k * size);
  }
  return field;
}

// Rows of one size in a plain file: every property where it stands in the row.
RowPlan KeepAll(const PlyElement& element) {
  RowPlan plan = PassAll(element);
  for (std::size_t p = 0; p < plan.steps.size(); ++p) Keep(plan, p);
  return plan;
}

bool HasLists(const PlyElement& element) {
  return std::any_of(element.properties.begin(), element.properties.end(),
                     [](const PlyProperty& p) { return p.is_list; });
}

// The faces, walked through row by row.
class PlyFaces final : public FaceWalker {
 public:
  PlyFaces(ByteSource& source, const PlyHeader& header, std::size_t first, RowPlan plan,
           bool wants_corners)
      : header_(header),
        input_(source, kWindowBytes),
        values_(OpenPlyValues(input_, header)),
        first_(first),
        plan_(std::move(plan)),
        wants_corners_(wants_corners) {}

  Result<void> Begin(const PlyMark& mark) {
    input_.Forget();
    if (auto ok = values_->Seek(mark); !ok) return ok;
    BeginElement(first_);
    return {};
  }

  Result<void> GoTo(std::uint64_t triangle, AttributedFace& face) override {
    while (triangle >= next_) {
      if (!Advance(triangle)) return values_->failure();
    }
    face.first = face_first_;
    face.corners = row_.corners.size();
    face.rows = wants_corners_ ? row_.corners : std::vector<std::int64_t>(face.corners);
    face.values = row_.kept;
    const std::size_t wedges = face.corners * wedge_bytes_;
    face.wedges = row_.wedges.size() == wedges ? row_.wedges : std::vector<char>();
    return {};
  }

 private:
  void BeginElement(std::size_t e) {
    element_ = e;
    if (e >= header_.elements.size()) return;
    const PlyElement& element = header_.elements[e];
    rows_left_ = element.count;
    strips_ = element.name == "tristrips";
    surface_ = IsSurface(element);
    indices_ = IndicesOf(element);
    steps_ = e == first_ ? plan_.steps : PassAll(element).steps;
    row_ = {};
    if (e == first_) row_.kept.resize(plan_.bytes);
    if (surface_) steps_[indices_].use = PlyStep::Use::kCorners;
    wedge_bytes_ = 0;
    for (const PlyStep& step : steps_) {
      if (step.use == PlyStep::Use::kWedges) {
        wedge_bytes_ = static_cast<std::size_t>(step.length) * PlySize(step.property.type);
      }
    }
    FindShape(element);
  }

  // Rows of triangles that have one size: see PlyValues::PassTriangles.
  void FindShape(const PlyElement& element) {
    list_ = stride_ = 0;
    const auto& properties = element.properties;
    const auto lists = std::count_if(properties.begin(), properties.end(),
                                     [](const PlyProperty& p) { return p.is_list; });
    if (!surface_ || strips_ || lists != 1 || PlySize(properties[indices_].count_type) != 1) return;
    for (std::size_t i = 0; i < properties.size(); ++i) {
      if (i == indices_) list_ = stride_;
      stride_ += i == indices_ ? 1 + 3 * PlySize(properties[i].type) : PlySize(properties[i].type);
    }
  }

  // Reads on until some face more has been read or passed over; never beyond that of `triangle`.
  bool Advance(std::uint64_t triangle) {
    if (element_ >= header_.elements.size()) {
      return values_->Reject("expected triangle " + std::to_string(triangle) +
                             "; did the file change meanwhile?");
    }
    if (rows_left_ == 0) {
      BeginElement(element_ + 1);
      return true;
    }
    if (strips_ && surface_) return ReadStripItem();
    if (stride_ > 0 && triangle > next_) {
      const std::uint64_t passed =
          values_->PassTriangles(list_, stride_, std::min(rows_left_, triangle - next_));
      rows_left_ -= passed;
      next_ += passed;
      if (rows_left_ == 0 || passed > 0) return true;
    }
    row_.wedges.clear();
    if (!values_->ReadRow(header_.elements[element_], rows_left_, steps_, row_)) return false;
    --rows_left_;
    if (!surface_) return true;
    face_first_ = next_;
    next_ += row_.corners.size() < 3 ? 1 : row_.corners.size() - 2;
    return true;
  }

  bool ReadStripItem() {
    const PlyProperty& p = header_.elements[element_].properties[indices_];
    if (!in_list_) {
      if (!BeginStripRow(p)) return false;
      in_list_ = true;
    }
    if (items_left_ == 0) return EndStripRow();
    --items_left_;
    std::int64_t index = 0;
    if (!values_->Index(p.type, index)) return false;
    IsStripEnd(index, p.type) ? EndStrip() : AddStripCorner(index);
    return true;
  }
  bool BeginStripRow(const PlyProperty& p) {
    if (!values_->BeginRow(header_.elements[element_], rows_left_)) return false;
    return PassOver(0, indices_) && values_->Length(p.count_type, items_left_);
  }
  bool EndStripRow() {
    EndStrip();
    in_list_ = false;
    --rows_left_;
    return PassOver(indices_ + 1, steps_.size()) && values_->EndRow();
  }
  bool PassOver(std::size_t from, std::size_t to) {
    for (; from < to; ++from) {
      const PlyProperty& p = steps_[from].property;
      std::uint64_t n = 1;
      if (p.is_list && !values_->Length(p.count_type, n)) return false;
      if (!values_->Skip(p.type, n)) return false;
    }
    return true;
  }
  // As FaceAssembler::AddStripCorner and EndStrip number them.
  void AddStripCorner(std::int64_t index) {
    const std::int64_t a = std::exchange(strip_[0], strip_[1]);
    const std::int64_t b = std::exchange(strip_[1], index);
    if (++strip_length_ < 3) return;
    const bool turned = strip_length_ % 2 == 0;
    row_.corners = {turned ? b : a, turned ? a : b, index};
    face_first_ = next_++;
  }
  void EndStrip() {
    if (strip_length_ == 1 || strip_length_ == 2) face_first_ = next_++;
    strip_length_ = 0;
  }

  const PlyHeader& header_;
  InputBuffer input_;
  std::unique_ptr<PlyValues> values_;
  const std::size_t first_;
  const RowPlan plan_;
  const bool wants_corners_;

  std::size_t element_ = 0;
  std::uint64_t rows_left_ = 0;
  bool surface_ = false, strips_ = false;
  std::size_t indices_ = 0, list_ = 0, stride_ = 0, wedge_bytes_ = 0;
  std::vector<PlyStep> steps_;
  PlyRow row_;
  std::uint64_t face_first_ = 0, next_ = 0;  // The triangles of the face that row_ holds.
  bool in_list_ = false;
  std::uint64_t items_left_ = 0, strip_length_ = 0;
  std::int64_t strip_[2] = {0, 0};
};

class PassOpener {
 public:
  PassOpener(ByteSource& source, const PlyHeader& header, const PlyPlaces& places,
             std::span<const PlyAttribute* const> wanted, RunContext& context)
      : source_(source), header_(header), places_(places), wanted_(wanted), context_(context) {}

  Result<std::unique_ptr<AttributePass>> Open() {
    mesh_.name = source_.name();
    const bool corners = std::any_of(wanted_.begin(), wanted_.end(), [](const PlyAttribute* a) {
      return !a->of_faces || a->wedges;
    });
    RowPlan of_faces = PlanFaces();
    sources_.resize(wanted_.size());
    for (std::size_t k = 0; k < wanted_.size(); ++k) {
      attributes_.push_back(wanted_[k]->what);
      if (wanted_[k]->of_faces) sources_[k] = OfFace(*wanted_[k], of_faces);
    }
    if (corners && places_.vertices) {
      if (auto ready = OpenVertices(); !ready) return Forward(ready);
    }
    auto faces =
        std::make_unique<PlyFaces>(source_, header_, places_.faces, std::move(of_faces), corners);
    if (auto begun = faces->Begin(places_.faces_mark); !begun) return Forward(begun);
    mesh_.faces = std::move(faces);
    return PassOver(std::move(mesh_), std::move(attributes_), std::move(sources_), context_);
  }

 private:
  RowPlan PlanFaces() const {
    if (places_.faces >= header_.elements.size()) return {};
    return PassAll(header_.elements[places_.faces]);
  }

  AttributeSource OfFace(const PlyAttribute& attribute, RowPlan& plan) {
    if (!attribute.wedges) {
      return {AttributeSource::Place::kFace, 0, FieldOf(attribute, plan)};
    }
    PlyStep& step = plan.steps[attribute.property[0]];
    step.use = PlyStep::Use::kWedges;
    step.length = static_cast<std::uint64_t>(attribute.what.components);
    RowField field{attribute.what.type, {}, false};
    const std::size_t size = SizeOf(attribute.what.type);
    for (std::size_t k = 0; k < step.length; ++k) field.offset.push_back(k * size);
    mesh_.wedge_bytes = attribute.what.bytes();
    return {AttributeSource::Place::kWedge, 0, field};
  }

  Result<void> OpenVertices() {
    const PlyElement& element = header_.elements[*places_.vertices];
    const bool in_file = header_.encoding != PlyEncoding::kAscii && !HasLists(element) &&
                         source_.can_read_at() && element.count > 0;
    const bool swap = in_file && header_.encoding == PlyEncoding::kBigEndian;
    RowPlan plan = in_file ? KeepAll(element) : PassAll(element);
    for (std::size_t a = 0; a < 3; ++a) {
      const auto at = element.Find(std::string_view("xyz").substr(a, 1));
      if (!at) return {};
      mesh_.position[a] = {ScalarOf(element.properties[*at].type), {Keep(plan, *at)}, swap};
    }
    for (std::size_t k = 0; k < wanted_.size(); ++k) {
      if (wanted_[k]->of_faces) continue;
      sources_[k] = {AttributeSource::Place::kTable, 0, FieldOf(*wanted_[k], plan)};
      sources_[k].field.swap = swap;
    }
    if (in_file) {
      mesh_.tables.push_back(std::make_unique<RowTable>(
          plan.bytes, source_, places_.vertices_mark.offset, element.count));
      return mesh_.tables.back()->LoadIfSmall(context_);
    }
    return LoadVertices(element, plan);
  }

  Result<void> LoadVertices(const PlyElement& element, const RowPlan& plan) {
    auto table = std::make_unique<RowTable>(plan.bytes, context_);
    InputBuffer input(source_, kWindowBytes);
    input.Forget();
    const auto values = OpenPlyValues(input, header_);
    if (auto ok = values->Seek(places_.vertices_mark); !ok) return ok;
    PlyRow row;
    row.kept.resize(plan.bytes);
    for (std::uint64_t left = element.count; left > 0; --left) {
      if (left % 65536 == 0 && context_.cancelled()) return Cancelled();
      if (!values->ReadRow(element, left, plan.steps, row)) return values->failure();
      if (auto added = table->Append(row.kept.data()); !added) return added;
    }
    if (auto done = table->Finish(); !done) return done;
    mesh_.tables.push_back(std::move(table));
    return {};
  }

  ByteSource& source_;
  const PlyHeader& header_;
  const PlyPlaces& places_;
  const std::span<const PlyAttribute* const> wanted_;
  RunContext& context_;
  IndexedMesh mesh_;
  std::vector<MeshAttribute> attributes_;
  std::vector<AttributeSource> sources_;
};

}  // namespace

bool LooksAtRows(const PlyHeader& header, const PlyPlaces& places) {
  const bool faces =
      places.faces < header.elements.size() && header.elements[places.faces].name == "face";
  return (places.vertices && HasMoreLists(header.elements[*places.vertices], SIZE_MAX)) ||
         (faces &&
          HasMoreLists(header.elements[places.faces], IndicesOf(header.elements[places.faces])));
}

Result<std::vector<PlyAttribute>> FindPlyAttributes(ByteSource& source, const PlyHeader& header,
                                                    const PlyPlaces& places) {
  std::vector<PlyAttribute> found;
  if (places.vertices) {
    const PlyElement& vertices = header.elements[*places.vertices];
    auto lengths = ListLengths(source, header, vertices, places.vertices_mark, SIZE_MAX);
    if (!lengths) return Forward(lengths);
    Finder finder(vertices, false, std::move(*lengths), found);
    for (const char* const axis : {"x", "y", "z"}) {
      if (const auto at = vertices.Find(axis)) finder.Use(*at);
    }
    finder.Find();
  }
  const bool faces = places.faces < header.elements.size();
  // The properties of a strip may come after its triangles.
  if (faces && header.elements[places.faces].name == "face") {
    const PlyElement& element = header.elements[places.faces];
    const std::size_t indices = IndicesOf(element);
    auto lengths = ListLengths(source, header, element, places.faces_mark, indices);
    if (!lengths) return Forward(lengths);
    Finder finder(element, true, std::move(*lengths), found);
    finder.Use(indices);
    finder.Find();
  }
  std::vector<MeshAttribute> named;
  for (const PlyAttribute& attribute : found) named.push_back(attribute.what);
  FixNames(named);
  for (std::size_t k = 0; k < found.size(); ++k) found[k].what = named[k];
  return found;
}

Result<std::unique_ptr<AttributePass>> OpenPlyAttributes(
    ByteSource& source, const PlyHeader& header, const PlyPlaces& places,
    std::span<const PlyAttribute* const> wanted, RunContext& context) {
  return PassOpener(source, header, places, wanted, context).Open();
}

}  // namespace strata::io
