#include "io/sample_writer.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <charconv>
#include <cstring>
#include <limits>
#include <map>
#include <sstream>

#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::HeaderFor;
using test::kProvenance;
using test::MessageOf;
using test::RandomSamples;
using test::ReadFile;
using test::TempFolder;
using test::WriteSamples;

const SampleFormat kFormats[] = {SampleFormat::kDraco, SampleFormat::kPly, SampleFormat::kXyz,
                                 SampleFormat::kNpz,   SampleFormat::kCsv, SampleFormat::kGlb,
#ifdef STRATA_VDB_PROGRAM
                                 SampleFormat::kVdb
#endif
};

// Numbers by column name, and the comments before them.
struct Table {
  std::vector<std::string> comments;
  std::vector<std::string> names;
  std::map<std::string, std::vector<double>> columns;
  std::size_t rows = 0;
};

template <class T>
double Take(const std::string& bytes, std::size_t& at) {
  T value;
  if (at + sizeof value > bytes.size()) throw std::out_of_range("the file is too short");
  std::memcpy(&value, bytes.data() + at, sizeof value);
  at += sizeof value;
  return static_cast<double>(value);
}

// Knows of PLY what the tests need, and nothing of the writer.
Table ParsePly(const std::string& bytes) {
  const std::string end = "end_header\n";
  std::size_t at = bytes.find(end) + end.size();
  std::istringstream header(bytes.substr(0, at));
  Table table;
  std::vector<std::string> types;
  for (std::string line; std::getline(header, line);) {
    std::istringstream words(line);
    std::string first, second, third;
    words >> first >> second >> third;
    if (first == "comment") table.comments.push_back(line.substr(8));
    if (first == "element") table.rows = std::stoull(third);
    if (first == "property") types.push_back(second), table.names.push_back(third);
  }
  for (std::size_t i = 0; i < table.rows; ++i) {
    for (std::size_t k = 0; k < types.size(); ++k) {
      const double value = types[k] == "double"  ? Take<double>(bytes, at)
                           : types[k] == "float" ? Take<float>(bytes, at)
                                                 : Take<std::int32_t>(bytes, at);
      table.columns[table.names[k]].push_back(value);
    }
  }
  EXPECT_EQ(at, bytes.size());
  return table;
}

Table ParseXyz(const std::string& bytes) {
  Table table;
  std::istringstream lines(bytes);
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with("# ")) {
      table.comments.push_back(line.substr(2));
      continue;
    }
    if (table.rows++ == 0) {
      std::istringstream names(table.comments.back());
      for (std::string name; names >> name;) table.names.push_back(name);
    }
    const char* at = line.data();
    for (const std::string& name : table.names) {
      double value = 0;
      const auto [stop, error] = std::from_chars(at, line.data() + line.size(), value);
      EXPECT_EQ(error, std::errc()) << line;
      table.columns[name].push_back(value);
      at = stop + (stop < line.data() + line.size());
    }
    EXPECT_EQ(at, line.data() + line.size()) << line;
  }
  return table;
}

void ExpectEqual(const Table& t, const SampleColumns& s) {
  ASSERT_EQ(t.rows, s.size());
  ASSERT_EQ(t.names,
            (std::vector<std::string>{"x", "y", "z", "nx", "ny", "nz", "triangle", "b0", "b1", "b2",
                                      "cell_x", "cell_y", "cell_z", "area", "weight"}));
  const auto at = [&](const char* name, std::size_t i) { return t.columns.at(name)[i]; };
  for (std::size_t i = 0; i < s.size(); ++i) {
    ASSERT_EQ((Vec3{at("x", i), at("y", i), at("z", i)}), s.position[i]) << "sample " << i;
    const Vec3 n{at("nx", i), at("ny", i), at("nz", i)};
    const Vec3f nf{static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)};
    ASSERT_EQ(nf, s.normal[i]) << "sample " << i;
    ASSERT_EQ(static_cast<std::uint64_t>(at("triangle", i)), s.triangle[i]) << "sample " << i;
    const std::array<double, 3> weights = {at("b0", i), at("b1", i), at("b2", i)};
    ASSERT_EQ(weights, s.barycentric[i]) << "sample " << i;
    const Cell cell{static_cast<int>(at("cell_x", i)), static_cast<int>(at("cell_y", i)),
                    static_cast<int>(at("cell_z", i))};
    ASSERT_EQ(cell, s.cell[i]) << "sample " << i;
    ASSERT_EQ(at("area", i), s.area[i]) << "sample " << i;
    ASSERT_EQ(at("weight", i), s.weight[i]) << "sample " << i;
  }
}

// Coordinates that are hard to keep: large, small, signed zero, subnormal.
SampleColumns HardSamples() {
  SampleColumns s = RandomSamples(500, 11);
  using Limits = std::numeric_limits<double>;
  s.position[0] = {1e7 + 0.1, -1e-300, -0.0};
  s.position[1] = {Limits::max(), Limits::lowest(), Limits::denorm_min()};
  s.position[2] = {1.0 / 3, 123456789.123456789, 5e-324};
  s.triangle[0] = 0;
  s.triangle[1] = std::uint64_t{1} << 53;
  s.cell[0] = {-(1 << 30), 1 << 30, 0};
  s.area[0] = 1e-200;
  return s;
}

TEST(SampleFormat, IsToldFromNamesAndSuffixes) {
  EXPECT_EQ(SampleFormatFromName("drc"), SampleFormat::kDraco);
  EXPECT_EQ(SampleFormatFromName("npz"), SampleFormat::kNpz);
  EXPECT_EQ(SampleFormatFromName("vdb"), SampleFormat::kVdb);
  EXPECT_EQ(SampleFormatFromName("PLY"), std::nullopt);
  EXPECT_EQ(SampleFormatFromPath("a/b.c/model.PLY"), SampleFormat::kPly);
  EXPECT_EQ(SampleFormatFromPath("model.xyz"), SampleFormat::kXyz);
  EXPECT_EQ(SampleFormatFromPath("folder.ply/model"), std::nullopt);
  EXPECT_EQ(SampleFormatFromPath("model.obj"), std::nullopt);
  EXPECT_EQ(SampleFormatFromPath(""), std::nullopt);
}

TEST(PlyWriter, KeepsEveryBitOfEveryColumn) {
  TempFolder folder;
  const SampleColumns samples = HardSamples();
  const auto size = WriteSamples(folder / "a.ply", SampleFormat::kPly, samples,
                                 HeaderFor(samples, kAllAttributes));
  ASSERT_TRUE(size) << MessageOf(size);
  const std::string bytes = ReadFile(folder / "a.ply");
  EXPECT_EQ(*size, bytes.size());
  EXPECT_TRUE(bytes.starts_with("ply\nformat binary_little_endian 1.0\n"));
  const Table table = ParsePly(bytes);
  ExpectEqual(table, samples);
  EXPECT_EQ(table.comments, std::vector{std::string("strata ") + kProvenance});
}

TEST(PlyWriter, LeavesOutWhatWasNotAskedFor) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(3, 5);
  ASSERT_TRUE(WriteSamples(folder / "a", SampleFormat::kPly, samples, HeaderFor(samples, 0)));
  EXPECT_EQ(ParsePly(ReadFile(folder / "a")).names, (std::vector<std::string>{"x", "y", "z"}));
  ASSERT_TRUE(WriteSamples(folder / "a", SampleFormat::kPly, samples, HeaderFor(samples, kArea)));
  EXPECT_EQ(ParsePly(ReadFile(folder / "a")).names,
            (std::vector<std::string>{"x", "y", "z", "area"}));
}

TEST(PlyWriter, RefusesATriangleThatADoubleCannotHold) {
  TempFolder folder;
  SampleColumns samples = RandomSamples(3, 5);
  samples.triangle[2] = (std::uint64_t{1} << 53) + 1;
  const auto written =
      WriteSamples(folder / "a", SampleFormat::kPly, samples, HeaderFor(samples, kTriangle));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kOverBudget);
  EXPECT_TRUE(folder.List().empty());
}

TEST(XyzWriter, KeepsEveryBitOfEveryColumn) {
  TempFolder folder;
  const SampleColumns samples = HardSamples();
  const auto size = WriteSamples(folder / "a.xyz", SampleFormat::kXyz, samples,
                                 HeaderFor(samples, kAllAttributes));
  ASSERT_TRUE(size) << MessageOf(size);
  const Table table = ParseXyz(ReadFile(folder / "a.xyz"));
  ExpectEqual(table, samples);
  ASSERT_EQ(table.comments.size(), 2u);
  EXPECT_EQ(table.comments[0], std::string("strata ") + kProvenance);
}

TEST(XyzWriter, HasRoomForTheLongestLine) {
  TempFolder folder;
  SampleColumns samples = RandomSamples(1, 5);
  const double longest = -1.2345678901234567e-300;
  samples.position[0] = {longest, longest, longest};
  samples.normal[0] = {-1.1754944e-38f, -1.1754944e-38f, -1.1754944e-38f};
  samples.triangle[0] = ~std::uint64_t{0};
  samples.barycentric[0] = {longest, longest, longest};
  samples.cell[0] = {INT32_MIN, INT32_MIN, INT32_MIN};
  samples.area[0] = samples.weight[0] = longest;
  const auto size =
      WriteSamples(folder / "a", SampleFormat::kXyz, samples, HeaderFor(samples, kAllAttributes));
  ASSERT_TRUE(size) << MessageOf(size);
  EXPECT_EQ(ParseXyz(ReadFile(folder / "a")).columns.at("area")[0], longest);
}

std::string NameOf(const ::testing::TestParamInfo<SampleFormat>& tested) {
  static constexpr const char* kNames[] = {"Drc", "Ply", "Xyz", "Npz", "Csv", "Glb", "Vdb"};
  return kNames[static_cast<std::size_t>(tested.param)];
}

class EveryFormat : public ::testing::TestWithParam<SampleFormat> {};
INSTANTIATE_TEST_SUITE_P(Formats, EveryFormat, ::testing::ValuesIn(kFormats), NameOf);

TEST_P(EveryFormat, GivesTheSameBytesWhateverThePortions) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(4097, 17);
  for (const AttributeSet attributes : {AttributeSet{0}, AttributeSet{kNormal}, kAllAttributes}) {
    const SampleHeader header = HeaderFor(samples, attributes);
    std::string first;
    for (const std::size_t portion : {SIZE_MAX, std::size_t{4096}, std::size_t{7}}) {
      const auto size = WriteSamples(folder / "a", GetParam(), samples, header, portion);
      ASSERT_TRUE(size) << MessageOf(size);
      const std::string bytes = ReadFile(folder / "a");
      EXPECT_EQ(*size, bytes.size());
      if (first.empty()) first = bytes;
      EXPECT_TRUE(bytes == first) << "portions of " << portion;
    }
  }
}

TEST_P(EveryFormat, GivesTheSameBytesInAnyTimeZone) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(10, 17);
  const SampleHeader header = HeaderFor(samples, kAllAttributes);
  std::string bytes[2];
  const char* zones[2] = {"UTC+11", "UTC-12"};
  for (int k = 0; k < 2; ++k) {
    setenv("TZ", zones[k], 1);
    tzset();
    const auto size = WriteSamples(folder / "a", GetParam(), samples, header);
    ASSERT_TRUE(size) << MessageOf(size);
    bytes[k] = ReadFile(folder / "a");
  }
  unsetenv("TZ");
  tzset();
  EXPECT_TRUE(bytes[0] == bytes[1]);
}

TEST_P(EveryFormat, RefusesNoSamples) {
  TempFolder folder;
  const auto written = WriteSamples(folder / "a", GetParam(), {}, HeaderFor({}, 0));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kEmptySurface);
  EXPECT_TRUE(folder.List().empty());
}

TEST_P(EveryFormat, RefusesMoreOrFewerSamplesThanAnnounced) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(10, 3);
  for (const std::uint64_t announced : {9, 11}) {
    SampleHeader header = HeaderFor(samples, kNormal);
    header.count = announced;
    const auto written = WriteSamples(folder / "a", GetParam(), samples, header);
    ASSERT_FALSE(written);
    EXPECT_EQ(written.error().code, ErrorCode::kInternal);
  }
  EXPECT_TRUE(folder.List().empty());
}

TEST_P(EveryFormat, RefusesColumnsThatContradictTheHeader) {
  TempFolder folder;
  SampleColumns samples = RandomSamples(10, 3);
  samples.area.pop_back();
  auto writer = OpenSampleWriter(folder / "a", GetParam(), HeaderFor(samples, kAllAttributes),
                                 test::ResourcesOfTests());
  ASSERT_TRUE(writer) << MessageOf(writer);
  const auto written = (*writer)->Write(samples);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kInternal);
  EXPECT_NE(written.error().message.find("'area'"), std::string::npos) << MessageOf(written);
}

TEST_P(EveryFormat, RefusesAPositionThatIsNotFinite) {
  TempFolder folder;
  for (const double bad : {HUGE_VAL, -HUGE_VAL, std::nan("")}) {
    SampleColumns samples = RandomSamples(10, 3);
    const SampleHeader header = HeaderFor(samples, kNormal);
    samples.position[4].y = bad;
    const auto written = WriteSamples(folder / "a", GetParam(), samples, header);
    ASSERT_FALSE(written);
    EXPECT_EQ(written.error().code, ErrorCode::kInternal);
  }
  EXPECT_TRUE(folder.List().empty());
}

TEST_P(EveryFormat, RefusesProvenanceOfSeveralLines) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(10, 3);
  SampleHeader header = HeaderFor(samples, kNormal);
  header.provenance = "{}\nelement face 1";
  const auto written = WriteSamples(folder / "a", GetParam(), samples, header);
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kInternal);
}

TEST_P(EveryFormat, AFullDiskIsAnErrorThatNamesTheFile) {
  const SampleColumns samples = RandomSamples(10, 3);
  const auto written =
      WriteSamples("/dev/full", GetParam(), samples, HeaderFor(samples, kAllAttributes));
  ASSERT_FALSE(written);
  EXPECT_EQ(written.error().code, ErrorCode::kIo);
  EXPECT_TRUE(written.error().message.starts_with("/dev/full: byte 0: cannot write "))
      << MessageOf(written);
}

TEST_P(EveryFormat, WritesIntoAPipe) {
  TempFolder folder;
  const SampleColumns samples = RandomSamples(10, 3);
  const SampleHeader header = HeaderFor(samples, kAllAttributes);
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  const auto piped =
      WriteSamples("/dev/fd/" + std::to_string(ends[1]), GetParam(), samples, header);
  close(ends[1]);
  ASSERT_TRUE(piped) << MessageOf(piped);
  std::string bytes(*piped + 1, '\0');
  EXPECT_EQ(read(ends[0], bytes.data(), bytes.size()), static_cast<ssize_t>(*piped));
  close(ends[0]);
  bytes.pop_back();
  ASSERT_TRUE(WriteSamples(folder / "a", GetParam(), samples, header));
  EXPECT_TRUE(ReadFile(folder / "a") == bytes);
}

}  // namespace
}  // namespace strata::io
