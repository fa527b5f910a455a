#include <algorithm>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <string>
#include <utility>
#include <vector>

#include "io/carried_columns.h"
#include "io/checked_writer.h"
#include "io/format_writers.h"

namespace strata::io {
namespace {

// All names with spaces between.
std::string ColumnNames(const SampleHeader& header) {
  static constexpr const char* kColumns[] = {
      " nx ny nz", " triangle", " b0 b1 b2", " cell_x cell_y cell_z", " area", " weight"};
  std::string text = "x y z";
  for (std::size_t k = 0; k < kAttributeNames.size(); ++k) {
    if ((header.attributes >> k & 1) != 0) text += kColumns[k];
  }
  for (const auto& names : ComponentNames(header.carried)) {
    for (const std::string& name : names) text += " " + name;
  }
  return text;
}

std::string HeaderText(const SampleHeader& header) {
  std::string text = "# strata " + header.provenance;
  if (!header.carried.empty()) text += "\n# columns " + ColumnsJson(header.carried);
  for (const MeshAttribute& column : header.carried) {
    if (!column.names.empty()) text += "\n# names " + column.name + " " + NamesJson(column);
  }
  return text + "\n# " + ColumnNames(header) + "\n";
}

// CSV with ',' between numbers, or text with ' '.
class XyzWriter final : public FileWriter {
 public:
  XyzWriter(std::unique_ptr<AtomicFile> file, const SampleHeader& header, char separator)
      : FileWriter(std::move(file), header), separator_(separator) {
    std::size_t numbers = kFixedNumbers;
    for (const MeshAttribute& column : header.carried) {
      numbers += static_cast<std::size_t>(column.components);
    }
    line_.resize(numbers * kLongest);
  }

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    for (std::size_t i = 0; i < columns.size(); ++i) {
      end_ = line_.data();
      PutSample(columns, i);
      end_[-1] = '\n';  // Instead of the last number's space.
      auto written = file().Write({line_.data(), static_cast<std::size_t>(end_ - line_.data())});
      if (!written) return written;
    }
    return {};
  }

 private:
  // The shortest text that reads back as the same number; never depends on the locale.
  template <class T>
  void Put(T value) {
    end_ = std::to_chars(end_, line_.data() + line_.size() - 1, value).ptr;
    *end_++ = separator_;
  }

  template <class T>
  void PutTriple(const T& t) {
    Put(t.x), Put(t.y), Put(t.z);
  }

  void PutSample(const SampleColumns& columns, std::size_t i) {
    PutTriple(columns.position[i]);
    if (has(kNormal)) PutTriple(columns.normal[i]);
    if (has(kTriangle)) Put(columns.triangle[i]);
    if (has(kBarycentric)) {
      for (const double weight : columns.barycentric[i]) Put(weight);
    }
    if (has(kCell)) PutTriple(columns.cell[i]);
    if (has(kArea)) Put(columns.area[i]);
    if (has(kWeight)) Put(columns.weight[i]);
    for (std::size_t k = 0; k < header().carried.size(); ++k) {
      const MeshAttribute& column = header().carried[k];
      PutCarried(column, columns.carried[k].data() + i * column.bytes());
    }
  }

  template <class T>
  void PutAll(const MeshAttribute& column, const char* value) {
    for (int c = 0; c < column.components; ++c, value += sizeof(T)) {
      T number;
      std::memcpy(&number, value, sizeof number);
      if constexpr (sizeof(T) == 1) {
        Put(static_cast<int>(number));  // A character otherwise.
      } else {
        Put(number);
      }
    }
  }
  void PutCarried(const MeshAttribute& column, const char* value) {
    WithType(column.type, [&](auto zero) { PutAll<decltype(zero)>(column, value); });
  }

  // Position, normal, triangle, weights, cell, area and weight.
  static constexpr std::size_t kFixedNumbers = 15;
  static constexpr std::size_t kLongest = 26;  // A double has up to 24 characters; and a space.
  const char separator_;
  std::vector<char> line_;
  char* end_ = nullptr;
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeXyzWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header) {
  auto written = file->Write(HeaderText(header));
  if (!written) return Forward(written);
  return std::make_unique<XyzWriter>(std::move(file), header, ' ');
}

Result<std::unique_ptr<SampleWriter>> MakeCsvWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header) {
  std::string names = ColumnNames(header);
  std::replace(names.begin(), names.end(), ' ', ',');
  auto written = file->Write(names + "\n");
  if (!written) return Forward(written);
  return std::make_unique<XyzWriter>(std::move(file), header, ',');
}

}  // namespace strata::io
