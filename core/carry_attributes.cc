#include "core/carry_attributes.h"

#include <tbb/parallel_sort.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <string>
#include <utility>

#include "core/external_sort.h"
#include "core/held_samples.h"

namespace strata {
namespace {

// So many points are asked of a reader at once: enough that what their corners share is read once.
constexpr std::size_t kMostPoints = 1 << 16;

bool IsAskedFor(const MeshAttribute& attribute, const std::string& name) {
  if (name == "all" || name == attribute.name) return true;
  return attribute.semantic != Semantic::kGeneric && attribute.semantic != Semantic::kNormal &&
         name == NameOf(attribute.semantic);
}

tl::unexpected<Error> Missing(const std::string& asked, std::span<const MeshAttribute> present) {
  return Fail(ErrorCode::kInvalidArgument, asked + "; the mesh carries: " + Describe(present));
}

// --- The columns of a plan --------------------------------------------------------------------

// What one fetched value is for, and where it stands in a row of all of them.
struct Fetched {
  std::size_t number;   // In MeshReader::attributes().
  std::size_t bytes;    // Of a value.
  std::size_t at;       // In a row.
  bool column = false;  // It becomes a column.
  bool normal = false;  // It becomes the normal.
};

struct Layout {
  std::vector<Fetched> fetched;
  std::vector<MeshAttribute> columns;
  const MeshAttribute* normal = nullptr;
  std::size_t row_bytes = 0;
};

Layout LayoutOf(std::span<const MeshAttribute> present, const CarryPlan& plan) {
  Layout layout;
  for (std::size_t n = 0; n < present.size(); ++n) {
    const bool column = std::binary_search(plan.wanted.begin(), plan.wanted.end(), n);
    const bool normal = plan.normal == n;
    if (!column && !normal) continue;
    layout.fetched.push_back({n, present[n].bytes(), layout.row_bytes, column, normal});
    layout.row_bytes += present[n].bytes();
    if (column) layout.columns.push_back(present[n]);
    if (normal) layout.normal = &present[n];
  }
  return layout;
}

double Component(const MeshAttribute& attribute, const char* value, std::size_t k) {
  if (attribute.type == ScalarType::kFloat64) {
    double wide;
    std::memcpy(&wide, value + k * sizeof wide, sizeof wide);
    return wide;
  }
  float single;
  std::memcpy(&single, value + k * sizeof single, sizeof single);
  return static_cast<double>(single);
}

// Of length one; `face` where the corners' normals cancel out or are none.
Vec3f UnitNormal(const MeshAttribute& attribute, const char* value, Vec3f face) {
  Vec3 n{Component(attribute, value, 0), Component(attribute, value, 1),
         Component(attribute, value, 2)};
  const double largest = std::max({std::fabs(n.x), std::fabs(n.y), std::fabs(n.z)});
  if (!(largest > 0) || !std::isfinite(n.x + n.y + n.z)) return face;
  n = n * (1 / largest);
  const double length = Norm(n);
  if (!std::isfinite(length)) return face;
  return {static_cast<float>(n.x / length), static_cast<float>(n.y / length),
          static_cast<float>(n.z / length)};
}

// Leaves out the fixed columns that were gathered for the plan alone.
void Drop(SampleColumns& samples, AttributeSet wanted) {
  if ((wanted & kNormal) == 0) samples.normal = {};
  if ((wanted & kTriangle) == 0) samples.triangle = {};
  if ((wanted & kBarycentric) == 0) samples.barycentric = {};
}

// --- All at once ------------------------------------------------------------------------------

// Asks a pass for points, as they come in ascending order, and hands each its row.
class RowFetcher {
 public:
  RowFetcher(AttributePass& pass, const Layout& layout, std::size_t most_points)
      : pass_(pass), layout_(layout), most_(most_points), points_() {
    points_.reserve(most_);
    for (const Fetched& f : layout.fetched) values_.emplace_back(most_ * f.bytes);
    for (std::vector<char>& column : values_) out_.push_back(column.data());
  }

  // `take(tag, values)` gets values[f], the value of layout.fetched[f], once it is known.
  template <class Take>
  Result<void> Add(const SurfacePoint& point, std::uint64_t tag, Take&& take) {
    points_.push_back(point);
    tags_.push_back(tag);
    return points_.size() < most_ ? Result<void>() : Flush(take);
  }
  template <class Take>
  Result<void> Flush(Take&& take) {
    if (points_.empty()) return {};
    if (auto read = pass_.Read(points_, out_); !read) return read;
    std::vector<const char*> values(layout_.fetched.size());
    for (std::size_t i = 0; i < points_.size(); ++i) {
      for (std::size_t f = 0; f < values.size(); ++f) {
        values[f] = values_[f].data() + i * layout_.fetched[f].bytes;
      }
      if (Result<void> taken = take(tags_[i], values); !taken) return taken;
    }
    points_.clear();
    tags_.clear();
    return {};
  }

 private:
  AttributePass& pass_;
  const Layout& layout_;
  const std::size_t most_;
  std::vector<SurfacePoint> points_;
  std::vector<std::uint64_t> tags_;
  std::vector<std::vector<char>> values_;
  std::vector<char*> out_;
};

class CarryJob {
 public:
  CarryJob(MeshReader& reader, const CarryPlan& plan, const SampleOptions& options,
           SampledMesh& sampled, RunContext& context)
      : reader_(reader),
        options_(options),
        sampled_(sampled),
        context_(context),
        layout_(LayoutOf(reader.attributes(), plan)) {}

  Result<void> Run() {
    sampled_.carried = layout_.columns;
    const std::uint64_t needed = sampled_.stats.survivors * (layout_.row_bytes + kSampleBytes);
    MemoryAccount& memory = context_.memory();
    if (memory.limited() && needed > memory.left() / 2) return OnScratch();
    auto share = memory.Take(needed, "the samples' attributes");
    if (!share) return Forward(share);
    return InMemory(std::move(*share));
  }

 private:
  // The fixed columns, a sort key and its number.
  static constexpr std::uint64_t kSampleBytes = 24 + 12 + 8 + 24 + 12 + 8 + 8 + 16;

  Result<std::unique_ptr<AttributePass>> OpenPass() {
    std::vector<std::size_t> numbers;
    for (const Fetched& f : layout_.fetched) numbers.push_back(f.number);
    return reader_.ReadAttributes(numbers, context_);
  }

  Result<void> InMemory(MemoryShare share);
  Result<void> OnScratch();

  MeshReader& reader_;
  const SampleOptions& options_;
  SampledMesh& sampled_;
  RunContext& context_;
  const Layout layout_;
};

Result<void> CarryJob::InMemory(MemoryShare share) {
  SampleColumns all, next;
  for (;;) {
    const auto more = sampled_.samples->Next(next);
    if (!more) return Forward(more);
    if (!*more) break;
    all.Append(std::move(next));
    next = {};
  }
  sampled_.samples.reset();
  const std::size_t n = all.size();
  std::vector<std::pair<std::uint64_t, std::uint64_t>> order(n);
  for (std::size_t i = 0; i < n; ++i) order[i] = {all.triangle[i], i};
  tbb::parallel_sort(order.begin(), order.end());
  for (const MeshAttribute& column : layout_.columns) all.carried.emplace_back(n * column.bytes());

  auto pass = OpenPass();
  if (!pass) return Forward(pass);
  RowFetcher fetcher(**pass, layout_, std::min(kMostPoints, n));
  const auto take = [&](std::uint64_t i, std::span<const char* const> values) -> Result<void> {
    std::size_t column = 0;
    for (std::size_t f = 0; f < values.size(); ++f) {
      const Fetched& fetched = layout_.fetched[f];
      if (fetched.normal) all.normal[i] = UnitNormal(*layout_.normal, values[f], all.normal[i]);
      if (!fetched.column) continue;
      std::memcpy(all.carried[column++].data() + i * fetched.bytes, values[f], fetched.bytes);
    }
    return {};
  };
  for (const auto& [triangle, i] : order) {
    if (auto added = fetcher.Add({triangle, all.barycentric[i]}, i, take); !added) return added;
  }
  if (auto done = fetcher.Flush(take); !done) return done;
  Drop(all, options_.attributes);
  sampled_.samples = std::make_unique<HeldSamples>(std::move(all), std::move(share));
  return {};
}

// --- On scratch space -------------------------------------------------------------------------

// Fixed columns on scratch, portion by portion as they came.
class ColumnSpool {
 public:
  static Result<std::unique_ptr<ColumnSpool>> Open(RunContext& context) {
    if (context.scratch() == nullptr) {
      return Fail(ErrorCode::kOverBudget,
                  "the samples' attributes do not fit the memory budget, and no scratch space was "
                  "given");
    }
    auto file = context.scratch()->NewFile();
    if (!file) return Forward(file);
    return std::unique_ptr<ColumnSpool>(new ColumnSpool(std::move(*file)));
  }

  Result<void> Append(SampleColumns& samples) {
    Result<void> ok;
    ForEach(samples, [&](auto& column) {
      const auto* const bytes = reinterpret_cast<const char*>(column.data());
      if (ok) ok = file_->Append({bytes, column.size() * sizeof column[0]});
    });
    portions_.push_back(samples.size());
    return ok;
  }
  // The same again from the front; false at the end. `out` has the columns that were appended.
  Result<bool> Next(SampleColumns& out, AttributeSet gathered) {
    if (next_ == portions_.size()) return false;
    Resize(out, gathered, portions_[next_++]);
    Result<void> ok;
    ForEach(out, [&](auto& column) {
      const std::span<char> bytes(reinterpret_cast<char*>(column.data()),
                                  column.size() * sizeof column[0]);
      if (ok) ok = file_->ReadAt(offset_, bytes);
      offset_ += bytes.size();
    });
    file_->Discard(0, offset_);
    if (!ok) return Forward(ok);
    return true;
  }

 private:
  explicit ColumnSpool(std::unique_ptr<ScratchFile> file) : file_(std::move(file)) {}

  template <class F>
  static void ForEach(SampleColumns& s, F&& f) {
    f(s.position), f(s.normal), f(s.triangle), f(s.barycentric), f(s.cell), f(s.area), f(s.weight);
  }
  static void Resize(SampleColumns& s, AttributeSet has, std::size_t n) {
    const auto of = [&](Attribute a) { return (has & a) != 0 ? n : 0; };
    s.position.resize(n);
    s.normal.resize(of(kNormal));
    s.triangle.resize(of(kTriangle));
    s.barycentric.resize(of(kBarycentric));
    s.cell.resize(of(kCell));
    s.area.resize(of(kArea));
    s.weight.resize(of(kWeight));
  }

  std::unique_ptr<ScratchFile> file_;
  std::vector<std::size_t> portions_;
  std::size_t next_ = 0;
  std::uint64_t offset_ = 0;
};

// A sample's place on its triangle, to be sorted by triangle.
struct PointRecord {
  std::uint64_t triangle, number;
  std::array<double, 3> weight;
};

// Zips the fixed columns with the rows of values, both in the samples' order.
class ZipSource : public SampleSource {
 public:
  ZipSource(std::unique_ptr<ColumnSpool> columns, std::unique_ptr<ExternalSort> rows,
            std::vector<Fetched> fetched, std::optional<MeshAttribute> normal,
            AttributeSet gathered, AttributeSet wanted)
      : columns_(std::move(columns)),
        rows_(std::move(rows)),
        fetched_(std::move(fetched)),
        normal_(std::move(normal)),
        gathered_(gathered),
        wanted_(wanted) {}

  Result<bool> Next(SampleColumns& out) override {
    const auto more = columns_->Next(out, gathered_);
    if (!more || !*more) return more;
    out.carried.clear();
    for (const Fetched& f : fetched_) {
      if (f.column) out.carried.emplace_back(out.size() * f.bytes);
    }
    for (std::size_t i = 0; i < out.size(); ++i) {
      const auto row = rows_->Next();
      if (!row) return Forward(row);
      Put(*row + sizeof(std::uint64_t), out, i);
    }
    Drop(out, wanted_);
    return true;
  }

 private:
  void Put(const char* row, SampleColumns& out, std::size_t i) const {
    std::size_t column = 0;
    for (const Fetched& f : fetched_) {
      if (f.normal) out.normal[i] = UnitNormal(*normal_, row + f.at, out.normal[i]);
      if (f.column) std::memcpy(out.carried[column++].data() + i * f.bytes, row + f.at, f.bytes);
    }
  }

  std::unique_ptr<ColumnSpool> columns_;
  std::unique_ptr<ExternalSort> rows_;
  const std::vector<Fetched> fetched_;
  const std::optional<MeshAttribute> normal_;
  const AttributeSet gathered_, wanted_;
};

Result<void> CarryJob::OnScratch() {
  const std::uint64_t part = std::max(context_.memory().left() / 4, ExternalSort::kLeastBytes);
  auto spool = ColumnSpool::Open(context_);
  if (!spool) return Forward(spool);
  auto by_triangle = ExternalSort::Open(sizeof(PointRecord), part, "the samples", context_);
  if (!by_triangle) return Forward(by_triangle);
  AttributeSet gathered = 0;
  SampleColumns next;
  for (std::uint64_t number = 0;;) {
    const auto more = sampled_.samples->Next(next);
    if (!more) return Forward(more);
    if (!*more) break;
    for (std::size_t i = 0; i < next.size(); ++i) {
      const PointRecord record{next.triangle[i], number++, next.barycentric[i]};
      auto added = (*by_triangle)->Add(reinterpret_cast<const char*>(&record));
      if (!added) return added;
    }
    gathered = kTriangle | kBarycentric | (next.normal.empty() ? 0u : kNormal) |
               (next.cell.empty() ? 0u : kCell) | (next.area.empty() ? 0u : kArea) |
               (next.weight.empty() ? 0u : kWeight);
    if (auto kept = (*spool)->Append(next); !kept) return kept;
  }
  sampled_.samples.reset();
  if (auto sorted = (*by_triangle)->Sort(); !sorted) return sorted;

  const std::size_t row_bytes = sizeof(std::uint64_t) + (layout_.row_bytes + 7) / 8 * 8;
  auto by_number = ExternalSort::Open(row_bytes, part, "the samples' attributes", context_);
  if (!by_number) return Forward(by_number);
  auto pass = OpenPass();
  if (!pass) return Forward(pass);
  const std::uint64_t per_point = layout_.row_bytes + sizeof(SurfacePoint) + 256;
  const std::uint64_t points =
      std::clamp<std::uint64_t>(context_.memory().left() / 4 / per_point, 256, kMostPoints);
  RowFetcher fetcher(**pass, layout_, static_cast<std::size_t>(points));
  std::vector<char> row(row_bytes);
  const auto take = [&](std::uint64_t number, std::span<const char* const> values) {
    std::memcpy(row.data(), &number, sizeof number);
    for (std::size_t f = 0; f < values.size(); ++f) {
      std::memcpy(row.data() + sizeof number + layout_.fetched[f].at, values[f],
                  layout_.fetched[f].bytes);
    }
    return (*by_number)->Add(row.data());
  };
  for (;;) {
    const auto next_point = (*by_triangle)->Next();
    if (!next_point) return Forward(next_point);
    if (*next_point == nullptr) break;
    PointRecord record;
    std::memcpy(&record, *next_point, sizeof record);
    auto added = fetcher.Add({record.triangle, record.weight}, record.number, take);
    if (!added) return added;
  }
  if (auto done = fetcher.Flush(take); !done) return done;
  by_triangle->reset();
  pass->reset();
  if (auto sorted = (*by_number)->Sort(); !sorted) return sorted;
  std::optional<MeshAttribute> normal;
  if (layout_.normal != nullptr) normal = *layout_.normal;
  sampled_.samples =
      std::make_unique<ZipSource>(std::move(*spool), std::move(*by_number), layout_.fetched,
                                  std::move(normal), gathered, options_.attributes);
  return {};
}

}  // namespace

Result<CarryPlan> PlanCarry(std::span<const MeshAttribute> present, const SampleOptions& options) {
  CarryPlan plan;
  std::vector<bool> wanted(present.size());
  for (const std::string& name : options.mesh_attributes) {
    bool found = name == "all";
    for (std::size_t n = 0; n < present.size(); ++n) {
      if (!IsAskedFor(present[n], name)) continue;
      wanted[n] = found = true;
    }
    if (!found) return Missing("the attribute '" + name + "' is not there", present);
  }
  for (std::size_t n = 0; n < present.size(); ++n) {
    if (wanted[n]) plan.wanted.push_back(n);
    const bool usable = present[n].semantic == Semantic::kNormal && present[n].components == 3 &&
                        !IsInteger(present[n].type);
    if (options.vertex_normals && usable && !plan.normal) plan.normal = n;
  }
  if (options.vertex_normals && !plan.normal) {
    return Missing("there are no vertex normals", present);
  }
  return plan;
}

Result<std::vector<std::string>> LeaveOutAbsent(MeshReader& reader, const SampleOptions& options,
                                                CarryPlan& plan, RunContext& context) {
  std::vector<std::string> left_out;
  std::vector<std::size_t> kept;
  for (const std::size_t n : plan.wanted) {
    const MeshAttribute& attribute = reader.attributes()[n];
    const bool named = std::ranges::any_of(options.mesh_attributes, [&](const std::string& name) {
      return name != "all" && IsAskedFor(attribute, name);
    });
    // What may be left out is decided before any work, by all of it and not by where samples fall.
    const auto checked =
        reader.CheckAttribute(n, named ? CheckDepth::kHeads : CheckDepth::kWhole, context);
    if (checked) {
      kept.push_back(n);
      continue;
    }
    const ErrorCode code = checked.error().code;
    const bool absent = code == ErrorCode::kNotFound || code == ErrorCode::kUnsupported ||
                        code == ErrorCode::kCorruptInput;
    if (!absent || named) {
      return Fail(code, "the attribute '" + attribute.name + "': " + checked.error().message);
    }
    left_out.push_back(attribute.name + ": " + checked.error().message);
  }
  plan.wanted = std::move(kept);
  return left_out;
}

AttributeSet GatheredFor(const CarryPlan& plan, const SampleOptions& options) {
  AttributeSet gathered = options.attributes;
  if (!plan.empty()) gathered |= kTriangle | kBarycentric;
  if (plan.normal) gathered |= kNormal;
  return gathered;
}

Result<void> CarryAttributes(MeshReader& reader, const CarryPlan& plan,
                             const SampleOptions& options, SampledMesh& sampled,
                             RunContext& context) {
  if (plan.empty()) return {};
  return CarryJob(reader, plan, options, sampled, context).Run();
}

}  // namespace strata
