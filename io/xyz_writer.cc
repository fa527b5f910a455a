#include <charconv>
#include <string>
#include <utility>

#include "io/checked_writer.h"
#include "io/format_writers.h"

namespace strata::io {
namespace {

std::string HeaderText(const SampleHeader& header) {
  static constexpr const char* kColumns[] = {" nx ny nz", " triangle", " b0 b1 b2",
                                             " cell_x cell_y cell_z", " area"};
  std::string text = "# strata " + header.provenance + "\n# x y z";
  for (std::size_t k = 0; k < kAttributeNames.size(); ++k) {
    if ((header.attributes >> k & 1) != 0) text += kColumns[k];
  }
  return text + "\n";
}

class XyzWriter final : public FileWriter {
 public:
  using FileWriter::FileWriter;

 protected:
  Result<void> Append(const SampleColumns& columns) override {
    for (std::size_t i = 0; i < columns.size(); ++i) {
      end_ = line_;
      PutSample(columns, i);
      end_[-1] = '\n';  // Instead of the last number's space.
      auto written = file().Write({line_, static_cast<std::size_t>(end_ - line_)});
      if (!written) return written;
    }
    return {};
  }

 private:
  // The shortest text that reads back as the same number; never depends on the locale.
  template <class T>
  void Put(T value) {
    end_ = std::to_chars(end_, line_ + sizeof line_ - 1, value).ptr;
    *end_++ = ' ';
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
  }

  // At most 7 doubles of 24 characters, 3 floats, 4 integers of up to 20, and spaces.
  char line_[512];
  char* end_ = line_;
};

}  // namespace

Result<std::unique_ptr<SampleWriter>> MakeXyzWriter(std::unique_ptr<AtomicFile> file,
                                                    const SampleHeader& header) {
  auto written = file->Write(HeaderText(header));
  if (!written) return Forward(written);
  return std::make_unique<XyzWriter>(std::move(file), header);
}

}  // namespace strata::io
