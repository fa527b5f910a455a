// Samples made up for the tests of writers.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <string>

#include "core/samples.h"
#include "io/sample_writer.h"

namespace strata::test {

inline constexpr const char* kProvenance =
    R"({"strata":"0.1.0","surface":"00ff","seed":7,"name":"Käfer \u00e9"})";

/// `n` samples with every column, in cells of edge `edge` within `cells` cells from `corner`.
inline SampleColumns RandomSamples(std::size_t n, std::uint64_t seed, double edge = 0.125,
                                   Vec3 corner = {}, double cells = 100) {
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> unit(0, 1), sides(-1, 1);
  SampleColumns s;
  for (std::size_t i = 0; i < n; ++i) {
    const Vec3 in_cells{cells * unit(random), cells * unit(random), cells * unit(random)};
    s.position.push_back(corner + in_cells * edge);
    const Vec3 d{sides(random), sides(random), sides(random) + 1e-9};
    const double length = Norm(d);
    s.normal.push_back({static_cast<float>(d.x / length), static_cast<float>(d.y / length),
                        static_cast<float>(d.z / length)});
    s.triangle.push_back(random() >> 12);
    const double b1 = unit(random) / 2, b2 = unit(random) / 2;
    s.barycentric.push_back({1 - b1 - b2, b1, b2});
    s.cell.push_back({static_cast<std::int32_t>(in_cells.x) - 50,
                      static_cast<std::int32_t>(in_cells.y) + 1'000'000,
                      static_cast<std::int32_t>(in_cells.z)});
    s.area.push_back(unit(random) * edge * edge);
    s.weight.push_back(1 - unit(random));
  }
  return s;
}

inline SampleHeader HeaderFor(const SampleColumns& samples, AttributeSet attributes,
                              double edge = 0.125) {
  SampleHeader header;
  header.count = samples.size();
  header.attributes = attributes;
  header.edge = edge;
  header.position_error = 0.01 * edge;
  header.provenance = kProvenance;
  for (const Vec3& p : samples.position) header.bounds.Add(p);
  return header;
}

/// Samples [first, first + n).
inline SampleColumns Slice(const SampleColumns& s, std::size_t first, std::size_t n) {
  const auto cut = [&](const auto& column) {
    const auto begin = column.begin() + static_cast<std::ptrdiff_t>(first);
    return std::decay_t<decltype(column)>(begin, begin + static_cast<std::ptrdiff_t>(n));
  };
  return {cut(s.position), cut(s.normal), cut(s.triangle), cut(s.barycentric),
          cut(s.cell),     cut(s.area),   cut(s.weight),   {}};
}

/// With the program that vdb needs, where the test knows it.
inline io::WriterResources ResourcesOfTests() {
  io::WriterResources resources;
#ifdef STRATA_VDB_PROGRAM
  resources.vdb_program = STRATA_VDB_PROGRAM;
#endif
  return resources;
}

/// Writes `samples` in portions of `portion`; returns the file's size.
inline Result<std::uint64_t> WriteSamples(const std::string& path, io::SampleFormat format,
                                          const SampleColumns& samples, const SampleHeader& header,
                                          std::size_t portion = SIZE_MAX) {
  auto writer = io::OpenSampleWriter(path, format, header, ResourcesOfTests());
  if (!writer) return Forward(writer);
  for (std::size_t i = 0; i < samples.size();) {
    const std::size_t n = std::min(portion, samples.size() - i);
    if (auto written = (*writer)->Write(Slice(samples, i, n)); !written) return Forward(written);
    i += n;
  }
  return (*writer)->Finish();
}

/// As a test's message.
template <class T>
std::string MessageOf(const Result<T>& result) {
  return result ? "no error" : result.error().message;
}

}  // namespace strata::test
