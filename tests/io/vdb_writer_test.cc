// vdb files: every number where OpenVDB's own library finds it, and what becomes of the program
// that writes them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "io/sample_writer.h"
#include "tests/support/mesh_attribute.h"
#include "tests/support/read_vdb.h"
#include "tests/support/sample_columns.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using nlohmann::json;
using test::HeaderFor;
using test::MakeAttribute;
using test::MessageOf;
using test::ReadVdb;
using test::TempFolder;
using test::VdbPoints;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;

constexpr double kEdge = 0.125;
const Vec3 kOrigin{-3.7, 1000.25, 12.3};

// One sample in each of `n` cells that lie on a wavy sheet, all columns set.
SampleColumns OnePerCell(std::size_t n, std::uint64_t seed) {
  SampleColumns s = test::RandomSamples(n, seed);
  std::mt19937_64 random(seed + 1);
  std::uniform_real_distribution<double> unit(0, 1);
  for (std::size_t i = 0; i < n; ++i) {
    const auto x = static_cast<std::int32_t>(i % 40) - 20,
               y = static_cast<std::int32_t>(i / 40) - 5;
    s.cell[i] = {x, y, (x * x + y) % 17 - 8};
    const Vec3 in_cells{x + unit(random), y + unit(random), s.cell[i].z + unit(random)};
    s.position[i] = kOrigin + in_cells * kEdge;
    s.triangle[i] = random() >> 1;
  }
  return s;
}

SampleHeader HeaderOn(const SampleColumns& samples, AttributeSet attributes) {
  SampleHeader header = HeaderFor(samples, attributes, kEdge);
  header.lattice_origin = kOrigin;
  return header;
}

WriterResources WithProgram(const std::string& program = STRATA_VDB_PROGRAM) {
  WriterResources resources;
  resources.vdb_program = program;
  return resources;
}

Result<std::uint64_t> Write(const std::string& path, const SampleColumns& samples,
                            const SampleHeader& header,
                            const WriterResources& resources = WithProgram()) {
  auto writer = OpenSampleWriter(path, SampleFormat::kVdb, header, resources);
  if (!writer) return Forward(writer);
  if (auto written = (*writer)->Write(samples); !written) return Forward(written);
  return (*writer)->Finish();
}

// Which sample each point is, by its voxel: one sample a cell.
std::vector<std::size_t> SamplesOf(const VdbPoints& points, const SampleColumns& samples) {
  std::map<Cell, std::size_t> by_cell;
  for (std::size_t i = 0; i < samples.size(); ++i) by_cell[samples.cell[i]] = i;
  std::vector<std::size_t> numbers;
  for (const Cell& voxel : points.voxel) {
    EXPECT_TRUE(by_cell.contains(voxel)) << voxel.x << " " << voxel.y << " " << voxel.z;
    numbers.push_back(by_cell[voxel]);
  }
  return numbers;
}

double LargestMove(const VdbPoints& points, const SampleColumns& samples) {
  const auto numbers = SamplesOf(points, samples);
  double most = 0;
  for (std::size_t p = 0; p < points.size(); ++p) {
    most = std::max(most, Norm(points.position[p] - samples.position[numbers[p]]));
  }
  return most;
}

TEST(VdbWriter, PutsEachSampleIntoTheVoxelOfItsCellAndItsPlace) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(3000, 4);
  const auto size = Write(folder / "a.vdb", samples, HeaderOn(samples, 0));
  ASSERT_TRUE(size) << MessageOf(size);
  EXPECT_EQ(*size, test::ReadFile(folder / "a.vdb").size());
  const VdbPoints points = ReadVdb(folder / "a.vdb");
  EXPECT_THAT(points.grids, ElementsAre("points"));
  EXPECT_THAT(points.creator, StartsWith("strata "));
  EXPECT_EQ(points.edge, kEdge);
  EXPECT_EQ(points.first_voxel, (kOrigin + Vec3{kEdge / 2, kEdge / 2, kEdge / 2}));
  EXPECT_THAT(points.names, ElementsAre("P"));
  ASSERT_EQ(points.size(), samples.size());
  EXPECT_EQ(points.active_voxels, samples.size());
  EXPECT_LE(LargestMove(points, samples), 0.01 * kEdge);
}

// The codec is the smallest that keeps the promise.
TEST(VdbWriter, MovesNoSampleFurtherThanThePositionError) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(3000, 5);
  SampleHeader header = HeaderOn(samples, 0);
  for (const auto& [edges, codec] : std::map<double, std::string>{
           {1, "fxpt8"}, {0.0068, "fxpt8"}, {0.0067, "fxpt16"}, {3e-5, "fxpt16"}, {2e-5, "null"}}) {
    header.position_error = edges * kEdge;
    ASSERT_TRUE(Write(folder / "a.vdb", samples, header));
    const VdbPoints points = ReadVdb(folder / "a.vdb");
    EXPECT_EQ(points.attributes.at("P").codec, codec) << edges;
    const double move = LargestMove(points, samples);
    EXPECT_LE(move, header.position_error) << edges;
    std::printf("%s: moved by at most %.3g edges\n", codec.c_str(), move / kEdge);
  }
  header.position_error = 1e-9 * kEdge;
  const auto refused = Write(folder / "b.vdb", samples, header);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_THAT(MessageOf(refused), HasSubstr("a position error of 1e-09 edges is finer"));
  EXPECT_THAT(folder.List(), ElementsAre("a.vdb"));
}

TEST(VdbWriter, KeepsSamplesOnFacesEdgesAndCornersInTheirOwnCell) {
  const TempFolder folder;
  SampleColumns samples;
  // Of 27 places of each cell: on its lower and upper faces, to the bit as the lattice computes
  // them, and in between. Cells are apart, so that a wrong voxel would be an empty one.
  for (int k = 0; k < 27; ++k) {
    const Cell cell{4 * (k % 3) - 9, 4 * (k / 3 % 3) + 2, 4 * (k / 9) - 1};
    const double places[] = {0, 0.5, 1};
    const double in[] = {cell.x + places[k % 3], cell.y + places[k / 3 % 3],
                         cell.z + places[k / 9]};
    samples.cell.push_back(cell);
    samples.position.push_back(kOrigin + Vec3{in[0], in[1], in[2]} * kEdge);
  }
  SampleHeader header = HeaderOn(samples, 0);
  for (const double edges : {0.01, 1e-4, 1e-6}) {
    header.position_error = edges * kEdge;
    ASSERT_TRUE(Write(folder / "a.vdb", samples, header));
    const VdbPoints points = ReadVdb(folder / "a.vdb");
    ASSERT_EQ(points.size(), 27u);
    EXPECT_LE(LargestMove(points, samples), header.position_error);
    for (const Vec3& p : points.in_voxel) {
      for (int a = 0; a < 3; ++a) {
        // Half open, so that who takes the points apart by position finds the same voxels.
        EXPECT_GE(p[a], -0.5);
        EXPECT_LT(p[a], 0.5);
      }
    }
  }
}

TEST(VdbWriter, PutsASampleOutsideOfItsCellWhereItLies) {
  const TempFolder folder;
  SampleColumns samples;
  samples.position = {kOrigin + Vec3{2.5, 3.25, -7.5} * kEdge};
  samples.cell = {{1, 3, -8}};
  ASSERT_TRUE(Write(folder / "a.vdb", samples, HeaderOn(samples, kCell)));
  const VdbPoints points = ReadVdb(folder / "a.vdb");
  ASSERT_EQ(points.size(), 1u);
  EXPECT_EQ(points.voxel[0], (Cell{2, 3, -8}));
  EXPECT_EQ(points.At<std::int32_t>("cell", 0, 0), 1);
  EXPECT_NEAR(points.in_voxel[0].y, -0.25, 0.004);
}

TEST(VdbWriter, KeepsTheOrderOfSamplesInOneVoxel) {
  const TempFolder folder;
  SampleColumns samples;
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> unit(0, 20);
  for (std::uint64_t i = 0; i < 40'000; ++i) {
    samples.position.push_back(kOrigin + Vec3{unit(random), unit(random), 0.5} * kEdge);
    samples.triangle.push_back(i);
  }
  ASSERT_TRUE(Write(folder / "a.vdb", samples, HeaderOn(samples, kTriangle)));
  const VdbPoints points = ReadVdb(folder / "a.vdb");
  ASSERT_EQ(points.size(), samples.size());
  EXPECT_EQ(points.active_voxels, 400u);
  std::map<Cell, std::int64_t> last;
  for (std::size_t p = 0; p < points.size(); ++p) {
    const auto number = points.At<std::int64_t>("triangle", p);
    const Vec3& position = samples.position[static_cast<std::size_t>(number)];
    EXPECT_EQ(points.voxel[p].x, std::floor((position.x - kOrigin.x) / kEdge));
    const auto [at, first] = last.emplace(points.voxel[p], number);
    if (!first) {
      EXPECT_LT(std::exchange(at->second, number), number);
    }
  }
}

struct Written {
  SampleColumns samples;
  SampleHeader header;
};

// Every fixed attribute, and one carried column of each kind.
Written WriteAll(const std::string& path) {
  Written w;
  w.samples = OnePerCell(700, 12);
  w.header = HeaderOn(w.samples, kAllAttributes);
  w.header.carried = {MakeAttribute("paint", ScalarType::kUint8, 4, Semantic::kColor),
                      MakeAttribute("st", ScalarType::kFloat64, 2, Semantic::kUv),
                      MakeAttribute("i8", ScalarType::kInt8, 3),
                      MakeAttribute("u8", ScalarType::kUint8, 1),
                      MakeAttribute("i16", ScalarType::kInt16, 1),
                      MakeAttribute("u16", ScalarType::kUint16, 2),
                      MakeAttribute("i32", ScalarType::kInt32, 1),
                      MakeAttribute("u32", ScalarType::kUint32, 1),
                      MakeAttribute("i64", ScalarType::kInt64, 1),
                      MakeAttribute("u64", ScalarType::kUint64, 2),
                      MakeAttribute("f32", ScalarType::kFloat32, 3),
                      MakeAttribute("f64", ScalarType::kFloat64, 1),
                      MakeAttribute("many", ScalarType::kFloat32, 6),
                      MakeAttribute("material", ScalarType::kUint16, 1, Semantic::kMaterial),
                      MakeAttribute("light", ScalarType::kUint16, 3, Semantic::kColor),
                      MakeAttribute("N", ScalarType::kFloat32, 1),
                      MakeAttribute("a-b", ScalarType::kFloat32, 1),
                      MakeAttribute("a_b", ScalarType::kFloat32, 1),
                      MakeAttribute("v1.2", ScalarType::kFloat32, 1)};
  w.header.carried[0].color_space = ColorSpace::kSrgb;
  w.header.carried[13].names = {"oak", "ash \"grey\""};
  std::mt19937_64 random(5);
  for (const MeshAttribute& column : w.header.carried) {
    std::vector<char>& bytes = w.samples.carried.emplace_back(700 * column.bytes());
    for (char& b : bytes) b = static_cast<char>(random());
    for (std::size_t i = 0; !IsInteger(column.type) && i < bytes.size(); i += SizeOf(column.type)) {
      const double unit = static_cast<double>(random() >> 11) * 0x1p-53;
      const auto single = static_cast<float>(unit);
      column.type == ScalarType::kFloat64 ? std::memcpy(&bytes[i], &unit, sizeof unit)
                                          : std::memcpy(&bytes[i], &single, sizeof single);
    }
  }
  const auto size = Write(path, w.samples, w.header);
  EXPECT_TRUE(size) << MessageOf(size);
  return w;
}

class EveryAttribute : public testing::Test {
 protected:
  // Component `k` of sample `i` in carried column `column`.
  template <class T>
  T Carried(std::size_t column, std::size_t i, std::size_t k = 0) const {
    T value;
    std::memcpy(&value,
                &w_.samples.carried[column][i * w_.header.carried[column].bytes() + k * sizeof(T)],
                sizeof(T));
    return value;
  }
  // Whether an attribute has the values of a column, one type for each side.
  template <class Stored, class Column>
  void ExpectSame(const char* name, std::size_t column, const char* type, std::uint32_t stride,
                  std::size_t components) const {
    const auto& attribute = points_.attributes.at(name);
    EXPECT_EQ(attribute.type, type) << name;
    EXPECT_EQ(attribute.stride, stride) << name;
    EXPECT_EQ(attribute.codec, "null") << name;
    for (std::size_t p = 0; p < points_.size(); ++p) {
      for (std::size_t k = 0; k < components; ++k) {
        ASSERT_EQ(points_.At<Stored>(name, p, k),
                  static_cast<Stored>(Carried<Column>(column, numbers_[p], k)))
            << name << " of point " << p;
      }
    }
  }

  const TempFolder folder_;
  const Written w_ = WriteAll(folder_ / "a.vdb");
  const VdbPoints points_ = ReadVdb(folder_ / "a.vdb");
  const std::vector<std::size_t> numbers_ = SamplesOf(points_, w_.samples);
};

TEST_F(EveryAttribute, IsNamedAsHoudiniNamesIt) {
  EXPECT_THAT(points_.names, ElementsAre("P", "N", "triangle", "barycentric", "cell", "area",
                                         "weight", "Cd", "Alpha", "uv", "i8", "u8", "i16", "u16",
                                         "i32", "u32", "i64", "u64", "f32", "f64", "many",
                                         "material", "light", "mesh_N", "a_b", "mesh_a_b", "v1_2"));
}

TEST_F(EveryAttribute, OfTheFixedOnesIsExact) {
  ASSERT_EQ(points_.size(), w_.samples.size());
  const SampleColumns& s = w_.samples;
  for (std::size_t p = 0; p < points_.size(); ++p) {
    const std::size_t i = numbers_[p];
    const Vec3f n{points_.At<float>("N", p, 0), points_.At<float>("N", p, 1),
                  points_.At<float>("N", p, 2)};
    ASSERT_EQ(n, s.normal[i]);
    ASSERT_EQ(points_.At<std::uint64_t>("triangle", p), s.triangle[i]);
    for (std::size_t k = 0; k < 3; ++k) {
      ASSERT_EQ(points_.At<double>("barycentric", p, k), s.barycentric[i][k]);
    }
    const Cell cell{points_.At<std::int32_t>("cell", p, 0), points_.At<std::int32_t>("cell", p, 1),
                    points_.At<std::int32_t>("cell", p, 2)};
    ASSERT_EQ(cell, s.cell[i]);
    ASSERT_EQ(points_.At<double>("area", p), s.area[i]);
    ASSERT_EQ(points_.At<double>("weight", p), s.weight[i]);
  }
  EXPECT_EQ(points_.attributes.at("N").type, "vec3s");
  EXPECT_EQ(points_.attributes.at("triangle").type, "int64");
  EXPECT_EQ(points_.attributes.at("barycentric").type, "vec3d");
}

TEST_F(EveryAttribute, OfTheMeshIsExact) {
  ExpectSame<std::int8_t, std::int8_t>("i8", 2, "int8", 3, 3);
  ExpectSame<std::int16_t, std::uint8_t>("u8", 3, "int16", 1, 1);
  ExpectSame<std::int16_t, std::int16_t>("i16", 4, "int16", 1, 1);
  ExpectSame<std::int32_t, std::uint16_t>("u16", 5, "int32", 2, 2);
  ExpectSame<std::int32_t, std::int32_t>("i32", 6, "int32", 1, 1);
  ExpectSame<std::int64_t, std::uint32_t>("u32", 7, "int64", 1, 1);
  ExpectSame<std::int64_t, std::int64_t>("i64", 8, "int64", 1, 1);
  ExpectSame<std::uint64_t, std::uint64_t>("u64", 9, "int64", 2, 2);
  ExpectSame<float, float>("f32", 10, "vec3s", 1, 3);
  ExpectSame<double, double>("f64", 11, "double", 1, 1);
  ExpectSame<float, float>("many", 12, "float", 6, 6);
  ExpectSame<std::int32_t, std::uint16_t>("material", 13, "int32", 1, 1);
  ExpectSame<std::int32_t, std::uint16_t>("light", 14, "int32", 3, 3);
  ExpectSame<float, float>("mesh_N", 15, "float", 1, 1);
  ExpectSame<float, float>("a_b", 16, "float", 1, 1);
  ExpectSame<float, float>("mesh_a_b", 17, "float", 1, 1);
  ExpectSame<float, float>("v1_2", 18, "float", 1, 1);
}

TEST_F(EveryAttribute, OfColourAndUvIsAVectorThatGivesTheColumnBack) {
  EXPECT_EQ(points_.attributes.at("Cd").type, "vec3s");
  EXPECT_EQ(points_.attributes.at("uv").type, "vec3d");
  for (std::size_t p = 0; p < points_.size(); ++p) {
    const std::size_t i = numbers_[p];
    for (std::size_t k = 0; k < 4; ++k) {
      const float c = k < 3 ? points_.At<float>("Cd", p, k) : points_.At<float>("Alpha", p);
      ASSERT_EQ(std::lround(c * 255.0f), Carried<std::uint8_t>(0, i, k));
      ASSERT_NEAR(c, Carried<std::uint8_t>(0, i, k) / 255.0, 1e-7);
    }
    ASSERT_EQ(points_.At<double>("uv", p, 0), Carried<double>(1, i, 0));
    ASSERT_EQ(points_.At<double>("uv", p, 1), Carried<double>(1, i, 1));
    ASSERT_EQ(points_.At<double>("uv", p, 2), 0);
  }
}

TEST_F(EveryAttribute, IsDescribedInTheMetadataWithItsTableOfNames) {
  EXPECT_EQ(points_.metadata.at("strata"), test::kProvenance);
  EXPECT_EQ(json::parse(points_.metadata.at("strata_names_material")),
            (json{"oak", "ash \"grey\""}));
  const json columns = json::parse(points_.metadata.at("strata_columns"));
  ASSERT_EQ(columns.size(), points_.names.size() - 1);
  for (std::size_t k = 0; k < columns.size(); ++k) {
    EXPECT_EQ(columns[k]["attribute"], points_.names[k + 1]);
  }
  EXPECT_EQ(columns[0]["name"], "normal");
  EXPECT_EQ(columns[6], (json{{"attribute", "Cd"},
                              {"name", "paint"},
                              {"type", "uint8"},
                              {"components", 4},
                              {"semantic", "color"},
                              {"color_space", "srgb"}}));
  EXPECT_EQ(columns[16]["type"], "uint64");
  EXPECT_EQ(columns[24]["name"], "a_b");
}

TEST_F(EveryAttribute, IsPrintedByVdbPrint) {
  FILE* const pipe = popen(("vdb_print -m '" + (folder_ / "a.vdb") + "' 2>&1").c_str(), "r");
  ASSERT_NE(pipe, nullptr);
  std::string text;
  char part[4096];
  while (const std::size_t n = fread(part, 1, sizeof part, pipe)) text.append(part, n);
  const int status = WEXITSTATUS(pclose(pipe));
  if (status == 127) GTEST_SKIP() << "vdb_print is missing: libopenvdb-tools";
  ASSERT_EQ(status, 0) << text;
  EXPECT_THAT(text, HasSubstr("points"));
  EXPECT_THAT(text, HasSubstr("ptdataidx32"));
  EXPECT_THAT(text, HasSubstr("file_voxel_count: 700"));
  EXPECT_THAT(text, HasSubstr("voxel size: 0.125"));
  EXPECT_THAT(text, HasSubstr("strata_names_material: [\"oak\",\"ash"));
}

// --- The bytes -----------------------------------------------------------------------------------

std::string UuidOf(const std::string& path) { return test::ReadFile(path).substr(21, 36); }

TEST(VdbWriter, NamesTheFileByWhatItHolds) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(100, 6);
  SampleHeader header = HeaderOn(samples, kNormal);
  for (const char* name : {"a", "again"}) ASSERT_TRUE(Write(folder / name, samples, header));
  header.provenance = "{}";
  ASSERT_TRUE(Write(folder / "other", samples, header));
  EXPECT_TRUE(test::ReadFile(folder / "a") == test::ReadFile(folder / "again"));
  EXPECT_THAT(UuidOf(folder / "a"),
              testing::MatchesRegex("[0-9a-f]{8}-[0-9a-f]{4}-8[0-9a-f]{3}-[89ab][0-9a-f]{3}-"
                                    "[0-9a-f]{12}"));
  EXPECT_NE(UuidOf(folder / "a"), UuidOf(folder / "other"));
}

TEST(VdbWriter, WritesTheSameBytesWithAndWithoutScratchSpaceAndBound) {
  const TempFolder folder, scratch;
  const SampleColumns samples = OnePerCell(60'000, 6);
  const SampleHeader header = HeaderOn(samples, kAllAttributes);
  ASSERT_TRUE(Write(folder / "plain", samples, header));
  auto space = ScratchFolder::Open(scratch.path());
  ASSERT_TRUE(space);
  MemoryAccount account(std::uint64_t{160} << 20);
  WriterResources resources = WithProgram();
  resources.memory = &account;
  ASSERT_TRUE(Write(folder / "bound", samples, header, resources));
  resources.scratch = space->get();
  // What is left shrinks the sorter, too: then it goes to disk.
  const auto taken = account.Take(std::uint64_t{100} << 20, "the rest of the job");
  const auto size = Write(folder / "scratch", samples, header, resources);
  ASSERT_TRUE(size) << MessageOf(size);
  EXPECT_TRUE(test::ReadFile(folder / "plain") == test::ReadFile(folder / "bound"));
  EXPECT_TRUE(test::ReadFile(folder / "plain") == test::ReadFile(folder / "scratch"));
  EXPECT_EQ(account.taken(), std::uint64_t{100} << 20);
}

// --- What goes wrong -----------------------------------------------------------------------------

TEST(VdbWriter, RefusesAGridWithoutMemoryForItsProgram) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(10, 7);
  MemoryAccount account(std::uint64_t{30} << 20);
  WriterResources resources = WithProgram();
  resources.memory = &account;
  const auto refused = Write(folder / "a.vdb", samples, HeaderOn(samples, 0), resources);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget) << MessageOf(refused);
  EXPECT_TRUE(folder.List().empty());
  EXPECT_EQ(account.taken(), 0u);
}

struct Peak {
  std::string error;       // Empty: written.
  std::int64_t bytes = 0;  // The highest resident set of strata-vdb.
};

// Writes in a process of its own, whose only child is strata-vdb.
Peak PeakWithin(std::uint64_t budget, const SampleColumns& samples, const TempFolder& folder) {
  int ends[2];
  EXPECT_EQ(pipe(ends), 0);
  const pid_t child = fork();
  if (child == 0) {
    auto scratch = ScratchFolder::Open(folder.path());
    if (!scratch) _exit(1);
    MemoryAccount account(budget);
    WriterResources resources = WithProgram();
    resources.memory = &account;
    resources.scratch = scratch->get();
    const auto written =
        Write(folder / "a.vdb", samples, HeaderOn(samples, kAllAttributes), resources);
    rusage usage{};
    getrusage(RUSAGE_CHILDREN, &usage);
    const std::string text =
        std::to_string(usage.ru_maxrss * 1024LL) + " " + (written ? "" : written.error().message);
    _exit(write(ends[1], text.data(), text.size()) > 0 ? 0 : 1);
  }
  close(ends[1]);
  char text[1000] = {};
  EXPECT_GT(read(ends[0], text, sizeof text - 1), 0);
  close(ends[0]);
  waitpid(child, nullptr, 0);
  char* rest = nullptr;
  Peak peak;
  peak.bytes = std::strtoll(text, &rest, 10);
  peak.error = rest + 1;
  return peak;
}

// A budget that is a little too small names what is needed; with that much it is written, and takes
// no more. The program's code, of which OpenVDB's library is most, is read from files and shared.
TEST(VdbWriter, AGridBeyondItsMemoryIsRefusedWithWhatItNeedsAndThatIsEnough) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(200'000, 7);
  constexpr std::uint64_t kMiB = std::uint64_t{1} << 20;
  const Peak refused = PeakWithin(64 * kMiB, samples, folder);
  EXPECT_THAT(refused.error, HasSubstr("OpenVDB's grid of 200000 samples needs "));
  EXPECT_TRUE(folder.List().empty());
  const auto at = refused.error.find("needs ");
  ASSERT_NE(at, std::string::npos) << refused.error;
  const std::uint64_t needed = std::strtoull(refused.error.c_str() + at + 6, nullptr, 10) * kMiB;
  // The sorter has an eighth, and the program 24 MiB.
  const Peak written = PeakWithin((needed + 24 * kMiB) * 8 / 7 + kMiB, samples, folder);
  EXPECT_EQ(written.error, "");
  const Peak nothing = PeakWithin(64 * kMiB, OnePerCell(1, 7), folder);
  EXPECT_EQ(nothing.error, "");
  const std::int64_t grown = written.bytes - nothing.bytes;
  std::printf("%lld bytes without points, %.1f a sample, counted as %.1f\n",
              static_cast<long long>(nothing.bytes), static_cast<double>(grown) / 200'000,
              static_cast<double>(needed) / 200'000);
  // Buffers of the compressor, which are among the 24 MiB.
  constexpr std::int64_t kBuffers = 3 * static_cast<std::int64_t>(kMiB);
  EXPECT_LE(grown, static_cast<std::int64_t>(needed) + kBuffers);
}

TEST(VdbWriter, AMissingProgramIsAnErrorBeforeAnyWork) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(10, 7);
  for (const std::string program : {"", "/nonexistent/strata-vdb"}) {
    const auto refused =
        Write(folder / "a.vdb", samples, HeaderOn(samples, 0), WithProgram(program));
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.error().code, ErrorCode::kUnsupported);
    EXPECT_THAT(MessageOf(refused), HasSubstr("vdb needs the program strata-vdb"));
  }
  EXPECT_TRUE(folder.List().empty());
}

TEST(VdbWriter, AProgramThatEndsTooEarlyIsAnErrorThatSaysHow) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(40'000, 7);
  const auto refused = Write(folder / "a.vdb", samples, HeaderOn(samples, kAllAttributes),
                             WithProgram("/bin/false"));
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  EXPECT_THAT(MessageOf(refused), HasSubstr("ended too early, with status 1"));
  EXPECT_TRUE(folder.List().empty());
}

TEST(VdbWriter, IsCancelledWhileTheProgramIsSilent) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(40'000, 7);
  RunContext context;
  WriterResources resources = WithProgram("/bin/cat");  // Takes everything, and never answers.
  resources.context = &context;
  auto writer =
      OpenSampleWriter(folder / "a.vdb", SampleFormat::kVdb, HeaderOn(samples, kNormal), resources);
  ASSERT_TRUE(writer) << MessageOf(writer);
  ASSERT_TRUE((*writer)->Write(samples));
  std::thread other([&] { context.Cancel(); });
  const auto finished = (*writer)->Finish();
  other.join();
  ASSERT_FALSE(finished);
  EXPECT_EQ(finished.error().code, ErrorCode::kCancelled);
  writer->reset();
  EXPECT_TRUE(folder.List().empty());
  EXPECT_EQ(waitpid(-1, nullptr, WNOHANG), -1) << "a child is left";
}

TEST(VdbWriter, AScratchDiskThatIsFullIsAnErrorThatNamesIt) {
  const TempFolder folder;
  const SampleColumns samples = OnePerCell(40'000, 7);
  auto scratch = ScratchFolder::Open(folder.path());
  ASSERT_TRUE(scratch);
  WriterResources resources = WithProgram();
  resources.scratch = scratch->get();
  rlimit before{};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &before), 0);
  rlimit small = before;
  small.rlim_cur = 100'000;
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const auto refused =
      Write(folder / "a.vdb", samples, HeaderOn(samples, kAllAttributes), resources);
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &before), 0);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kIo);
  EXPECT_THAT(MessageOf(refused), StartsWith("scratch space " + folder.path() + ": "));
  EXPECT_TRUE(folder.List().empty());
}

TEST(VdbWriter, RefusesSamplesFurtherApartThanItCounts) {
  const TempFolder folder;
  SampleColumns samples = OnePerCell(1, 7);
  samples.position.push_back({1e9, 1e9, 1e9});
  samples.cell.clear();
  SampleHeader header = HeaderOn(samples, 0);
  const auto refused = Write(folder / "a.vdb", samples, header);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_THAT(MessageOf(refused), HasSubstr("further apart"));
}

TEST(VdbWriter, RefusesCellsTooSmallForATransformAndWritesTheSmallestOnes) {
  const TempFolder folder;
  const auto write_with_edge = [&](double edge) {
    SampleColumns sample;
    sample.position = {{edge / 4, edge / 4, edge / 4}};
    SampleHeader header = HeaderOn(sample, 0);
    header.edge = edge;
    header.lattice_origin = {};
    header.position_error = edge / 100;
    return Write(folder / "a.vdb", sample, header);
  };
  const auto refused = write_with_edge(1.44e-5);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, ErrorCode::kOverBudget);
  EXPECT_THAT(MessageOf(refused), HasSubstr("edge of 1.44e-05 are too small for a vdb"));
  const auto written = write_with_edge(1.45e-5);
  EXPECT_TRUE(written) << MessageOf(written);
}

}  // namespace
}  // namespace strata::io
