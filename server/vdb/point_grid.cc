#include "server/vdb/point_grid.h"

#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <openvdb/points/PointDataGrid.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <set>
#include <streambuf>
#include <string>
#include <utility>
#include <vector>

namespace strata::server {
namespace {

namespace points = openvdb::points;
using io::VdbAttribute;
using io::VdbCodec;
using io::VdbHead;
using io::VdbPlace;
using io::VdbType;
using Leaf = points::PointDataTree::LeafNodeType;
using LowerNode = points::PointDataTree::RootNodeType::ChildNodeType::ChildNodeType;
using UpperNode = points::PointDataTree::RootNodeType::ChildNodeType;
using Descriptor = points::AttributeSet::Descriptor;
using points::AttributeArray;
using points::TypedAttributeArray;

constexpr std::uint32_t kVoxels = Leaf::SIZE;

// What the C library's allocator adds to an object, its rounding included.
constexpr std::uint64_t kAllocation = 24;

// --- The file ------------------------------------------------------------------------------------

// Bytes to a descriptor, at places of the caller's choice.
class FileBuffer : public std::streambuf {
 public:
  explicit FileBuffer(int descriptor) : descriptor_(descriptor), buffer_(std::size_t{1} << 18) {
    setp(buffer_.data(), buffer_.data() + buffer_.size());
  }
  std::uint64_t size() const { return std::max(size_, at_); }
  void Flush() {
    const char* from = pbase();
    while (from < pptr()) {
      const ssize_t n = pwrite(descriptor_, from, static_cast<std::size_t>(pptr() - from),
                               static_cast<off_t>(at_));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) throw DiskError(errno);
      from += n;
      at_ += static_cast<std::uint64_t>(n);
    }
    size_ = std::max(size_, at_);
    setp(buffer_.data(), buffer_.data() + buffer_.size());
  }

 protected:
  int_type overflow(int_type c) override {
    Flush();
    if (traits_type::eq_int_type(c, traits_type::eof())) return traits_type::not_eof(c);
    *pptr() = traits_type::to_char_type(c);
    pbump(1);
    return c;
  }
  int sync() override {
    Flush();
    return 0;
  }
  pos_type seekoff(off_type offset, std::ios_base::seekdir from, std::ios_base::openmode) override {
    const std::uint64_t here = at_ + static_cast<std::uint64_t>(pptr() - pbase());
    if (from == std::ios_base::cur && offset == 0) return static_cast<off_type>(here);
    Flush();
    const std::uint64_t base = from == std::ios_base::beg   ? 0
                               : from == std::ios_base::cur ? here
                                                            : size_;
    at_ = base + static_cast<std::uint64_t>(offset);
    return static_cast<off_type>(at_);
  }
  pos_type seekpos(pos_type place, std::ios_base::openmode which) override {
    return seekoff(place, std::ios_base::beg, which);
  }

 private:
  int descriptor_;
  std::vector<char> buffer_;
  std::uint64_t at_ = 0, size_ = 0;  // Of the buffer's front; of the file.
};

// OpenVDB's own writer, which writes to files that it opens itself otherwise.
class GridArchive : public openvdb::io::Archive {
 public:
  void WriteTo(std::ostream& out, const openvdb::GridBase::ConstPtr& grid,
               const openvdb::MetaMap& metadata) const {
    Archive::write(out, openvdb::GridCPtrVec{grid}, /*seekable=*/true, metadata);
  }
};

// The tag that the library drew stands behind the magic number, three versions and a flag.
void ReplaceTag(int descriptor, const std::string& drawn, const std::string& ours) {
  constexpr off_t kAt = 8 + 3 * 4 + 1;
  std::string found(drawn.size(), '\0');
  const auto size = static_cast<ssize_t>(drawn.size());
  if (ours.size() != drawn.size() || pread(descriptor, found.data(), found.size(), kAt) != size ||
      found != drawn) {
    throw std::runtime_error("the file's tag is not where OpenVDB writes it");
  }
  if (pwrite(descriptor, ours.data(), ours.size(), kAt) != size) throw DiskError(errno);
}

// --- Attributes ----------------------------------------------------------------------------------

template <class T>
openvdb::NamePair TypeOf(bool vector) {
  if constexpr (std::is_floating_point_v<T>) {
    if (vector) return TypedAttributeArray<openvdb::math::Vec3<T>>::attributeType();
  }
  return TypedAttributeArray<T>::attributeType();
}

// Calls `visit` with a zero of the type.
template <class Visit>
auto WithType(VdbType type, const Visit& visit) {
  switch (type) {
    case VdbType::kInt8:
      return visit(std::int8_t{});
    case VdbType::kInt16:
      return visit(std::int16_t{});
    case VdbType::kInt32:
      return visit(std::int32_t{});
    case VdbType::kInt64:
      return visit(std::int64_t{});
    case VdbType::kFloat:
      return visit(float{});
    default:
      return visit(double{});
  }
}

// A leaf's rows, in the order of its points.
struct Rows {
  const std::vector<const char*>& row;
  std::uint32_t size() const { return static_cast<std::uint32_t>(row.size()); }
};

// Values of type T, `stride` a point, which stand at byte `at` of each row.
template <class T>
AttributeArray::Ptr CopyValues(const Rows& rows, std::size_t at, std::uint32_t stride) {
  auto array = TypedAttributeArray<T>::create(rows.size(), stride);
  array->expand(false);
  for (std::uint32_t i = 0; i < rows.size(); ++i) {
    for (std::uint32_t k = 0; k < stride; ++k) {
      T value;
      std::memcpy(static_cast<void*>(&value), rows.row[i] + at + k * sizeof(T), sizeof(T));
      array->setUnsafe(i * stride + k, value);
    }
  }
  return array;
}

AttributeArray::Ptr ArrayOf(const VdbAttribute& attribute, const Rows& rows, std::size_t at) {
  return WithType(attribute.type, [&](auto zero) -> AttributeArray::Ptr {
    using T = decltype(zero);
    if constexpr (std::is_floating_point_v<T>) {
      if (attribute.vector) return CopyValues<openvdb::math::Vec3<T>>(rows, at, 1);
    }
    return CopyValues<T>(rows, at, attribute.components);
  });
}

// OpenVDB cuts what is behind a step off; the middle of the right step comes out as it should. The
// last step is the next voxel's first: nothing is rounded up to it.
template <std::uint32_t kSteps>
float MiddleOfStep(float position) {
  const double step = std::floor((static_cast<double>(position) + 0.5) * kSteps + 0.5);
  return static_cast<float>((std::min(step, kSteps - 1.0) + 0.5) / kSteps - 0.5);
}

template <class Codec, class Move>
AttributeArray::Ptr Positions(const Rows& rows, const Move& move) {
  auto array = TypedAttributeArray<openvdb::Vec3f, Codec>::create(rows.size());
  array->expand(false);
  for (std::uint32_t i = 0; i < rows.size(); ++i) {
    VdbPlace place;
    std::memcpy(&place, rows.row[i], sizeof place);
    const auto& p = place.position;
    array->setUnsafe(i, openvdb::Vec3f(move(p[0]), move(p[1]), move(p[2])));
  }
  return array;
}

AttributeArray::Ptr PositionsOf(VdbCodec codec, const Rows& rows) {
  switch (codec) {
    case VdbCodec::kFixed8:
      return Positions<points::FixedPointCodec<true>>(rows, MiddleOfStep<255>);
    case VdbCodec::kFixed16:
      return Positions<points::FixedPointCodec<false>>(rows, MiddleOfStep<65535>);
    default:
      return Positions<points::NullCodec>(rows, [](float x) { return x; });
  }
}

openvdb::NamePair PositionType(VdbCodec codec) {
  using openvdb::Vec3f;
  switch (codec) {
    case VdbCodec::kFixed8:
      return TypedAttributeArray<Vec3f, points::FixedPointCodec<true>>::attributeType();
    case VdbCodec::kFixed16:
      return TypedAttributeArray<Vec3f, points::FixedPointCodec<false>>::attributeType();
    default:
      return TypedAttributeArray<Vec3f>::attributeType();
  }
}

Descriptor::Ptr DescriptorOf(const VdbHead& head) {
  Descriptor::Ptr descriptor = Descriptor::create(PositionType(head.codec));
  for (const VdbAttribute& attribute : head.attributes) {
    const auto type = WithType(attribute.type,
                               [&](auto zero) { return TypeOf<decltype(zero)>(attribute.vector); });
    descriptor = descriptor->duplicateAppend(attribute.name, type);
  }
  return descriptor;
}

openvdb::Coord OriginOf(const std::array<std::int32_t, 3>& voxel, int bits) {
  const std::int32_t mask = ~((1 << bits) - 1);
  return {voxel[0] & mask, voxel[1] & mask, voxel[2] & mask};
}

}  // namespace

DiskError::DiskError(int errno_of_write)
    : std::runtime_error("cannot write"), number(errno_of_write) {}

// --- The grid ------------------------------------------------------------------------------------

class PointGrid::Leaves {
 public:
  explicit Leaves(const VdbHead& head) : head_(head) {
    openvdb::initialize();
    descriptor_ = DescriptorOf(head);
    row_bytes_ = io::VdbRowBytes(head.attributes);
    tree_ = std::make_shared<points::PointDataTree>();
  }

  void Add(const char* row) {
    VdbPlace place;
    std::memcpy(&place, row, sizeof place);
    const openvdb::Coord origin = OriginOf(place.voxel, Leaf::LOG2DIM);
    if (!waiting_.empty() && origin != origin_) Close();
    origin_ = origin;
    waiting_.insert(waiting_.end(), row, row + row_bytes_);
    most_waiting_ = std::max<std::uint64_t>(most_waiting_, waiting_.capacity());
  }

  void End() {
    if (!waiting_.empty()) Close();
    std::vector<char>().swap(waiting_);
  }

  std::uint64_t bytes() const { return bytes_ + 2 * most_waiting_; }
  bool over_memory() const { return head_.memory_bytes != 0 && bytes() > head_.memory_bytes; }

  std::uint64_t Write(int descriptor) {
    auto grid = points::PointDataGrid::create(tree_);
    grid->setName("points");
    grid->setCreator(head_.creator);
    grid->setTransform(NewTransform());
    for (const auto& [key, text] : head_.metadata) {
      grid->insertMeta(key, openvdb::StringMetadata(text));
    }
    GridArchive archive;
    archive.setCompression(openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    FileBuffer buffer(descriptor);
    std::ostream out(&buffer);
    out.exceptions(std::ios::badbit);  // Rethrows what the buffer throws.
    archive.WriteTo(out, grid, {});
    buffer.Flush();
    ReplaceTag(descriptor, archive.getUniqueTag(), head_.uuid);
    return buffer.size();
  }

 private:
  // To the bit: a transform made of a map goes by way of a matrix, and loses the last one.
  openvdb::math::Transform::Ptr NewTransform() const {
    auto transform = std::make_shared<openvdb::math::Transform>();
    transform->preScale(head_.edge);
    const auto& at = head_.first_voxel;
    transform->postTranslate(openvdb::Vec3d(at[0], at[1], at[2]));
    return transform;
  }

  // Makes a leaf of the points that wait.
  void Close() {
    Count();
    if (over_memory()) tree_.reset();
    if (tree_ != nullptr) tree_->addLeaf(NewLeaf().release());
    waiting_.clear();
  }

  std::unique_ptr<Leaf> NewLeaf() {
    const std::size_t n = waiting_.size() / row_bytes_;
    std::array<std::uint32_t, kVoxels> end{};
    std::vector<std::uint16_t> voxel(n);
    for (std::size_t i = 0; i < n; ++i) {
      VdbPlace place;
      std::memcpy(&place, waiting_.data() + i * row_bytes_, sizeof place);
      const auto& v = place.voxel;
      voxel[i] = static_cast<std::uint16_t>(Leaf::coordToOffset({v[0], v[1], v[2]}));
      ++end[voxel[i]];
    }
    for (std::size_t k = 1; k < kVoxels; ++k) end[k] += end[k - 1];
    // By voxel, and in one voxel as they came.
    std::vector<const char*> order(n);
    std::array<std::uint32_t, kVoxels> next = end;
    for (std::size_t i = n; i-- > 0;) order[--next[voxel[i]]] = &waiting_[i * row_bytes_];

    auto leaf = std::make_unique<Leaf>(origin_);
    leaf->replaceAttributeSet(NewAttributes({order}).release(), true);
    std::vector<Leaf::ValueType> offsets(end.begin(), end.end());
    leaf->setOffsets(offsets, /*updateValueMask=*/true);
    return leaf;
  }

  std::unique_ptr<points::AttributeSet> NewAttributes(const Rows& rows) const {
    auto attributes = std::make_unique<points::AttributeSet>(descriptor_, rows.size());
    Replace(*attributes, 0, PositionsOf(head_.codec, rows));
    std::size_t at = sizeof(VdbPlace);
    for (std::size_t k = 0; k < head_.attributes.size(); ++k) {
      Replace(*attributes, k + 1, ArrayOf(head_.attributes[k], rows, at));
      at += head_.attributes[k].bytes();
    }
    return attributes;
  }

  static void Replace(points::AttributeSet& attributes, std::size_t k,
                      const AttributeArray::Ptr& array) {
    array->compact();  // One value where all are alike.
    if (attributes.replace(k, array) != k) {
      throw std::runtime_error("an attribute is not of its type");
    }
  }

  // What the points that wait take as a leaf, and the nodes above it.
  void Count() {
    // The object, its values, and the count of its owners.
    constexpr std::uint64_t kArray = sizeof(TypedAttributeArray<openvdb::Vec3d>) + 24 +
                                     3 * kAllocation + sizeof(AttributeArray::Ptr);
    const std::uint64_t n = waiting_.size() / row_bytes_;
    bytes_ += sizeof(Leaf) + kVoxels * sizeof(Leaf::ValueType) + sizeof(points::AttributeSet) +
              4 * kAllocation + (head_.attributes.size() + 1) * kArray +
              n * (row_bytes_ - sizeof(VdbPlace) + sizeof(openvdb::Vec3f));
    if (lower_.insert(OriginOf({origin_[0], origin_[1], origin_[2]}, LowerNode::TOTAL)).second) {
      bytes_ += sizeof(LowerNode) + sizeof(openvdb::Coord) + 4 * kAllocation;
    }
    if (upper_.insert(OriginOf({origin_[0], origin_[1], origin_[2]}, UpperNode::TOTAL)).second) {
      bytes_ += sizeof(UpperNode) + sizeof(openvdb::Coord) + 8 * kAllocation;
    }
  }

  const VdbHead& head_;
  std::size_t row_bytes_ = 0;
  Descriptor::Ptr descriptor_;
  points::PointDataTree::Ptr tree_;  // Null once it is given up.
  openvdb::Coord origin_;
  std::vector<char> waiting_;  // The leaf's rows.
  std::uint64_t bytes_ = 0, most_waiting_ = 0;
  std::set<openvdb::Coord> lower_, upper_;
};

PointGrid::PointGrid(const io::VdbHead& head) : leaves_(std::make_unique<Leaves>(head)) {}
PointGrid::~PointGrid() = default;
void PointGrid::Add(const char* row) { leaves_->Add(row); }
void PointGrid::End() { leaves_->End(); }
std::uint64_t PointGrid::bytes() const { return leaves_->bytes(); }
bool PointGrid::over_memory() const { return leaves_->over_memory(); }
std::uint64_t PointGrid::Write(int descriptor) { return leaves_->Write(descriptor); }

}  // namespace strata::server
