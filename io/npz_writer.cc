#include <algorithm>
#include <bit>
#include <limits>
#include <memory>
#include <new>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "io/carried_columns.h"
#include "io/checked_writer.h"
#include "io/format_writers.h"
#include "io/sample_rows.h"
#include "io/spool.h"
#include "io/stored_zip.h"

namespace strata::io {
namespace {

static_assert(std::endian::native == std::endian::little,
              "arrays are copied as they lie in memory");

// The front of a .npy file, version 1.0: padded so that the data begins at a multiple of 64.
std::string NpyHeader(const std::string& type, const std::string& shape) {
  std::string dict =
      "{'descr': '" + type + "', 'fortran_order': False, 'shape': (" + shape + "), }";
  constexpr std::size_t kPrefix = 10;
  dict.append(63 - (kPrefix + dict.size()) % 64, ' ');
  dict += '\n';
  std::string header("\x93NUMPY\x01\x00", 8);
  header += static_cast<char>(dict.size() & 255);
  header += static_cast<char>(dict.size() >> 8);
  return header + dict;
}

// UTF-8 to code points; what is not UTF-8 becomes U+FFFD, byte by byte.
std::u32string DecodeUtf8(std::string_view text) {
  std::u32string points;
  for (std::size_t i = 0; i < text.size();) {
    const auto lead = static_cast<unsigned char>(text[i]);
    const int length = lead < 0x80 ? 1 : std::countl_one(lead);
    bool good = length == 1 ? lead < 0x80 : length <= 4 && i + length <= text.size();
    char32_t point = length == 1 ? lead : lead & (0x7F >> length);
    for (int k = 1; good && k < length; ++k) {
      const auto next = static_cast<unsigned char>(text[i + static_cast<std::size_t>(k)]);
      good = (next & 0xC0) == 0x80;
      point = point << 6 | (next & 0x3F);
    }
    static constexpr char32_t kSmallest[] = {0, 0, 0x80, 0x800, 0x10000};
    good = good && point >= kSmallest[length] && point <= 0x10FFFF && (point >> 11) != 0x1B;
    points += good ? point : U'\uFFFD';
    i += good ? static_cast<std::size_t>(length) : 1;
  }
  return points;
}

// Arrays as members of a zip: each a header and the numbers.
class NpzArchive {
 public:
  NpzArchive(AtomicFile& file, const RunContext* context) : zip_(file), context_(context) {}

  Result<void> Open() { return zip_.Open(); }

  // A member `name`.npy: `header`, then all bytes of `data`, which gives its space back.
  Result<void> Add(const std::string& name, const std::string& header, Spool& data) {
    if (auto begun = Begin(name, header, data.size()); !begun) return begun;
    std::vector<char> portion(kPortion);
    for (std::uint64_t done = 0; done < data.size();) {
      if (context_ != nullptr && context_->cancelled()) return Cancelled();
      const std::uint64_t n = std::min<std::uint64_t>(portion.size(), data.size() - done);
      const std::span<char> part(portion.data(), n);
      if (auto read = data.Read(done, part); !read) return read;
      if (auto put = zip_.Put(part); !put) return put;
      data.DiscardBefore(done += n);
    }
    return {};
  }
  // As above, with data at hand.
  Result<void> Add(const std::string& name, const std::string& header, std::span<const char> data) {
    if (auto begun = Begin(name, header, data.size()); !begun) return begun;
    return zip_.Put(data);
  }

  Result<void> Close() { return zip_.Close(); }

 private:
  static constexpr std::size_t kPortion = std::size_t{1} << 18;

  Result<void> Begin(const std::string& name, const std::string& header, std::uint64_t bytes) {
    if (auto begun = zip_.Begin(name + ".npy", header.size() + bytes); !begun) return begun;
    return zip_.Put({header.data(), header.size()});
  }

  StoredZip zip_;
  const RunContext* context_;
};

// What an array is called, its type, the numbers of a sample in it, and their bytes.
struct ArrayKind {
  AttributeSet attribute;  // 0: always there.
  std::string name;
  const char* type;
  int components;
  std::uint64_t sample_bytes;
  std::size_t carried = 0;  // Which carried column, if attribute is kCarried.
};
constexpr AttributeSet kCarried = ~kAllAttributes;

const char* TypeOf(ScalarType type) {
  constexpr const char* kTypes[] = {"|i1", "|u1", "<i2", "<u2", "<i4",
                                    "<u4", "<i8", "<u8", "<f4", "<f8"};
  return kTypes[static_cast<std::size_t>(type)];
}

// All arrays of the header's samples.
std::vector<ArrayKind> ArraysOf(const SampleHeader& header) {
  std::vector<ArrayKind> arrays = {
      {0, "position", "<f8", 3, 24},        {kNormal, "normal", "<f4", 3, 12},
      {kTriangle, "triangle", "<u8", 1, 8}, {kBarycentric, "barycentric", "<f8", 3, 24},
      {kCell, "cell", "<i4", 3, 12},        {kArea, "area", "<f8", 1, 8},
      {kWeight, "weight", "<f8", 1, 8},
  };
  std::erase_if(arrays, [&](const ArrayKind& kind) {
    return kind.attribute != 0 && (header.attributes & kind.attribute) == 0;
  });
  for (std::size_t k = 0; k < header.carried.size(); ++k) {
    const MeshAttribute& column = header.carried[k];
    arrays.push_back(
        {kCarried, column.name, TypeOf(column.type), column.components, column.bytes(), k});
  }
  return arrays;
}

// Whole columns stand one after the other in the zip, so each waits in a spool of its own.
class NpzWriter final : public FileWriter {
 public:
  NpzWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header, const RunContext* context)
      : FileWriter(std::move(file), header), context_(context) {}

  Result<void> OpenSpools(const WriterResources& resources) {
    for (const ArrayKind& kind : ArraysOf(header())) {
      if (header().count > kMostBytes / kind.sample_bytes) {
        return Fail(ErrorCode::kOverBudget, name() + ": " + std::to_string(header().count) +
                                                " samples are more than a file can hold");
      }
      auto spool =
          Spool::Open(resources.scratch, resources.memory, header().count * kind.sample_bytes,
                      name() + ": the column '" + kind.name + "'");
      if (!spool) return Forward(spool);
      arrays_.push_back({kind, std::move(*spool)});
    }
    return {};
  }

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    for (const Array& array : arrays_) {
      if (auto added = array.spool->Append(BytesIn(columns, array.kind)); !added) return added;
    }
    return {};
  }

  Result<std::uint64_t> Complete() override try {
    NpzArchive zip(file(), context_);
    auto done = zip.Open();
    if (done) done = AddText(zip, "provenance", header().provenance);
    if (done && !header().carried.empty()) {
      done = AddText(zip, "columns", ColumnsJson(header().carried));
    }
    for (const MeshAttribute& column : header().carried) {
      if (done && !column.names.empty()) done = AddNames(zip, column);
    }
    for (Array& array : arrays_) {
      if (done) done = AddArray(zip, array);
    }
    if (done) done = zip.Close();
    if (!done) return Forward(done);
    return file().Finish();
  } catch (const std::bad_alloc&) {
    return Fail(ErrorCode::kOverBudget, name() + ": out of memory; ply and xyz need none");
  }

 private:
  // The largest file of Linux.
  static constexpr std::uint64_t kMostBytes = std::numeric_limits<std::int64_t>::max() / 8;

  struct Array {
    ArrayKind kind;
    std::unique_ptr<Spool> spool;  // Null once it is in the zip.
  };

  static std::string_view BytesIn(const SampleColumns& columns, const ArrayKind& kind) {
    if (kind.attribute != kCarried) return ColumnBytes(columns, kind.attribute);
    const std::vector<char>& bytes = columns.carried[kind.carried];
    return {bytes.data(), bytes.size()};
  }

  // An array without dimensions.
  static Result<void> AddText(NpzArchive& zip, const std::string& name, const std::string& utf8) {
    return AddPoints(zip, name, DecodeUtf8(utf8), "", 1);
  }
  // `<column>_names`: samples[column_names][samples[column]] is what a sample's number is called.
  static Result<void> AddNames(NpzArchive& zip, const MeshAttribute& column) {
    std::size_t longest = 1;
    for (const std::string& name : column.names) {
      longest = std::max(longest, DecodeUtf8(name).size());
    }
    std::u32string points;
    for (std::size_t k = 0; k < column.names.size(); ++k) {
      points += DecodeUtf8(column.names[k]);
      points.resize((k + 1) * longest, U'\0');
    }
    return AddPoints(zip, column.name + "_names", points, std::to_string(column.names.size()) + ",",
                     column.names.size());
  }
  static Result<void> AddPoints(NpzArchive& zip, const std::string& name,
                                const std::u32string& points, const std::string& shape,
                                std::size_t items) {
    const std::string type = "<U" + std::to_string(points.size() / items);
    return zip.Add(name, NpyHeader(type, shape),
                   std::span<const char>(reinterpret_cast<const char*>(points.data()),
                                         points.size() * sizeof(char32_t)));
  }

  Result<void> AddArray(NpzArchive& zip, Array& array) {
    const ArrayKind& kind = array.kind;
    std::string shape = std::to_string(header().count) + ",";
    if (kind.components > 1) shape += " " + std::to_string(kind.components);
    auto added = zip.Add(kind.name, NpyHeader(kind.type, shape), *array.spool);
    array.spool.reset();
    return added;
  }

  const RunContext* context_;
  std::vector<Array> arrays_;
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeNpzWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header,
                                                    const WriterResources& resources) {
  auto writer = std::make_unique<NpzWriter>(std::move(file), header, resources.context);
  if (auto opened = writer->OpenSpools(resources); !opened) return Forward(opened);
  return writer;
}

}  // namespace strata::io
