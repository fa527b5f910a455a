// Meshes whose vertices exceed their budget, through the door that everyone uses.
#include "io/far_vertices.h"

#include <gtest/gtest.h>
#include <sys/mount.h>
#include <unistd.h>

#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/sample_mesh.h"
#include "core/summarize_mesh.h"
#include "io/byte_source.h"
#include "io/open_mesh.h"
#include "tests/support/compress.h"
#include "tests/support/failing_source.h"
#include "tests/support/read_mesh.h"
#include "tests/support/samples_equal.h"
#include "tests/support/soup.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

using test::Order;
using test::ReadWhole;
using test::Soup;
using test::WholeMesh;

constexpr std::uint64_t kTriangles = 60000;
constexpr Order kOrders[] = {Order::kCoherent, Order::kShuffledVertices, Order::kAllShuffled};

struct Scratch {
  test::TempFolder parent;
  std::unique_ptr<ScratchFolder> folder = *ScratchFolder::Open(parent.path());
};

OpenOptions Within(std::uint64_t budget, const Scratch& scratch) {
  OpenOptions options;
  options.vertex_budget = budget;
  options.scratch = scratch.folder.get();
  return options;
}

// Half of the vertices' bytes, an eighth, and too little for anything but a handful of pages.
std::vector<std::uint64_t> BudgetsFor(const Soup& soup) {
  const std::uint64_t bytes = soup.vertices.size() * 12;
  return {bytes / 2, bytes / 8, 6144};
}

void ExpectSame(const WholeMesh& mesh, const WholeMesh& expected, const std::string& what) {
  EXPECT_EQ(mesh.ids, expected.ids) << what;
  EXPECT_EQ(mesh.triangles.size(), expected.triangles.size()) << what;
  EXPECT_TRUE(mesh.triangles == expected.triangles) << what;
  EXPECT_EQ(mesh.counts.vertices, expected.counts.vertices) << what;
  EXPECT_EQ(mesh.counts.faces, expected.counts.faces) << what;
  EXPECT_EQ(mesh.counts.triangles, expected.counts.triangles) << what;
  EXPECT_EQ(mesh.counts.skipped, expected.counts.skipped) << what;
}

WholeMesh MustRead(const std::string& bytes, const OpenOptions& options = {},
                   std::size_t batch = 2048) {
  auto mesh = ReadWhole(OpenMesh(MemorySource(bytes, "mesh"), options), batch);
  EXPECT_TRUE(mesh) << mesh.error().message;
  return mesh ? *mesh : WholeMesh{};
}

TEST(FarVertices, GiveTheSameTrianglesInEveryFormatPackingOrderAndBudget) {
  const Scratch scratch;
  for (const Order order : kOrders) {
    const Soup soup = test::SphereSoup(kTriangles, order, true);
    for (const std::string format : test::kSoupFormats) {
      const std::string bytes = test::SoupBytes(soup, format);
      const WholeMesh expected = MustRead(bytes);
      EXPECT_GT(expected.skipped(SkipReason::kIndexOutOfRange), 0u);
      EXPECT_GT(expected.skipped(SkipReason::kTooFewCorners), 0u);
      for (const std::string& stored : {bytes, test::Gzip(bytes), test::Zstd(bytes)}) {
        for (const std::uint64_t budget : BudgetsFor(soup)) {
          const WholeMesh mesh = MustRead(stored, Within(budget, scratch));
          ExpectSame(mesh, expected,
                     format + " order " + std::to_string(static_cast<int>(order)) + " " +
                         std::to_string(budget));
          EXPECT_TRUE(mesh.vertices.empty());
        }
      }
    }
  }
}

TEST(FarVertices, GiveTheSameTrianglesForEveryBatchSize) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kAllShuffled, true);
  const std::string bytes = test::SoupBytes(soup, "binary_little_endian");
  const WholeMesh expected = MustRead(bytes);
  for (const std::size_t batch : {1, 3, 100, 1 << 20}) {
    ExpectSame(MustRead(bytes, Within(soup.vertices.size() * 12 / 8, scratch), batch), expected,
               std::to_string(batch));
  }
}

TEST(FarVertices, GiveTheSameSamplesAndSums) {
  const Scratch scratch;
  for (const Order order : kOrders) {
    const Soup soup = test::SphereSoup(kTriangles, order, true);
    for (const std::string format : {"binary_little_endian", "obj"}) {
      const std::string bytes = test::SoupBytes(soup, format);
      for (const LatticeSpec& lattice : {LatticeSpec(Resolution{40}), LatticeSpec(Height{6})}) {
        SampleOptions options;
        options.lattice = lattice;
        RunContext context;
        auto near = OpenMesh(MemorySource(bytes));
        const auto expected = SampleMesh(**near, options, context);
        ASSERT_TRUE(expected) << expected.error().message;
        for (const std::uint64_t budget : BudgetsFor(soup)) {
          auto far = OpenMesh(MemorySource(bytes), Within(budget, scratch));
          ASSERT_TRUE(far) << far.error().message;
          const auto result = SampleMesh(**far, options, context);
          ASSERT_TRUE(result) << result.error().message;
          EXPECT_TRUE(test::SameSamples(result->samples, expected->samples)) << budget;
          EXPECT_TRUE(test::SameStats(result->stats, expected->stats)) << budget;
          EXPECT_EQ(result->stats.mesh_area, expected->stats.mesh_area);
          EXPECT_EQ(result->stats.passes, expected->stats.passes);
        }
      }
    }
  }
}

TEST(FarVertices, AreVisitedAtAnyTime) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kAllShuffled, false);
  for (const std::string format : test::kSoupFormats) {
    const std::string bytes = test::SoupBytes(soup, format);
    const WholeMesh expected = MustRead(bytes);
    auto reader = OpenMesh(MemorySource(bytes), Within(soup.vertices.size() * 12 / 8, scratch));
    ASSERT_TRUE(reader) << reader.error().message;
    TriangleBatch batch(2048);
    WholeMesh mesh;
    do {
      std::vector<Vec3> vertices;
      auto visited = (*reader)->VisitVertices([&](const VertexView& some) {
        for (std::size_t i = 0; i < some.size(); ++i) vertices.push_back(some[i]);
      });
      ASSERT_TRUE(visited && *visited);
      EXPECT_TRUE(vertices == expected.vertices) << format;
      ASSERT_TRUE((*reader)->Read(batch));
      for (std::size_t i = 0; i < batch.size(); ++i) {
        mesh.triangles.push_back({batch.corner(i, 0), batch.corner(i, 1), batch.corner(i, 2)});
      }
    } while (batch.size() > 0);
    EXPECT_TRUE(mesh.triangles == expected.triangles) << format;
  }
}

TEST(FarVertices, RewindFromEveryState) {
  const Scratch scratch;
  for (const Order order : kOrders) {
    const Soup soup = test::SphereSoup(kTriangles, order, true);
    for (const std::string format : test::kSoupFormats) {
      const std::string bytes = test::SoupBytes(soup, format);
      const WholeMesh expected = MustRead(bytes);
      auto reader = OpenMesh(MemorySource(bytes), Within(soup.vertices.size() * 12 / 8, scratch));
      ASSERT_TRUE(reader) << reader.error().message;
      TriangleBatch batch(999);
      for (const int reads : {0, 1, 3, 20, 32, 40}) {
        for (int i = 0; i < reads; ++i) ASSERT_TRUE((*reader)->Read(batch));
        ASSERT_TRUE((*reader)->Rewind());
        auto mesh = ReadWhole(**reader, 1000);
        ASSERT_TRUE(mesh) << mesh.error().message;
        ExpectSame(*mesh, expected, format + " after " + std::to_string(reads));
        // Reading ahead and going back leaves no trace in the progress.
        EXPECT_EQ((*reader)->bytes_read(), bytes.size()) << format;
        EXPECT_EQ((*reader)->bytes_total(), bytes.size()) << format;
        ASSERT_TRUE((*reader)->Rewind());
      }
    }
  }
}

// A sheet of strips, each with pairs of corners that belong to no triangle and some out of range.
std::string StripsPly(const std::string& format, bool shuffled) {
  constexpr std::uint64_t kSide = 120;
  const test::Permutation moved(kSide * kSide, 5);
  const auto name = [&](std::uint64_t i) { return static_cast<double>(shuffled ? moved(i) : i); };
  test::PlyPart vertices = test::PlyVertices({});
  for (std::uint64_t i = 0; i < kSide * kSide; ++i) {
    const std::uint64_t at = shuffled ? moved.Inverse(i) : i;
    const auto x = static_cast<double>(at % kSide), y = static_cast<double>(at / kSide);
    vertices.rows.push_back({x, y, x * y / 64});
  }
  test::PlyPart strips{"tristrips", {"list int int vertex_indices"}, {{}}};
  std::vector<double>& row = strips.rows[0];
  for (std::uint64_t k = 0; k < 4 * (kSide - 1); ++k) {
    const std::uint64_t y = k % (kSide - 1);
    for (std::uint64_t x = 0; x < kSide; ++x) {
      row.push_back(name(y * kSide + x));
      row.push_back(name((y + 1) * kSide + x));
    }
    if (y % 10 == 3) row.push_back(99999999);
    row.push_back(-1);
    if (y % 10 == 4) row.insert(row.end(), {name(y), name(y + 1), -1});
  }
  row.insert(row.begin(), static_cast<double>(row.size()));
  return test::MakePly(format, {vertices, strips});
}

TEST(FarVertices, ServeStripsLongerThanASegment) {
  const Scratch scratch;
  for (const bool shuffled : {false, true}) {
    for (const std::string format : test::kPlyFormats) {
      const std::string bytes = StripsPly(format, shuffled);
      const WholeMesh expected = MustRead(bytes);
      EXPECT_GT(expected.skipped(SkipReason::kIndexOutOfRange), 0u);
      for (const std::uint64_t budget : {80000, 40000, 6144}) {
        ExpectSame(MustRead(bytes, Within(budget, scratch), 500), expected,
                   format + " " + std::to_string(budget));
      }
    }
  }
}

// Faces among their vertices, named from behind.
TEST(FarVertices, ServeObjFilesWithRelativeIndices) {
  const Scratch scratch;
  const test::Permutation moved(12000, 3);
  std::string obj;
  for (std::uint64_t i = 0; i < 12000; ++i) {
    obj += "v " + std::to_string(i % 97) + " " + std::to_string(i % 89) + "." + std::to_string(i) +
           " " + std::to_string(i) + "\n";
    if (i < 300) continue;
    obj += "f -1";
    for (std::uint64_t k = 0; k < 2 + i % 4; ++k) {
      obj += " -" + std::to_string(1 + (k * 97 + moved(i)) % (i + 1));
    }
    obj += "\n";
  }
  const WholeMesh expected = MustRead(obj);
  for (const std::uint64_t budget : {144000, 36000, 20000}) {
    ExpectSame(MustRead(obj, Within(budget, scratch)), expected, std::to_string(budget));
  }
}

// Rows with other properties around the coordinates, of each type.
TEST(FarVertices, ServeRowsOfEveryShape) {
  const Scratch scratch;
  const test::Permutation moved(9000, 17);
  for (const std::string type : {"float", "double", "int", "uint", "short", "uchar"}) {
    test::PlyPart vertices{
        "vertex", {"uchar red", type + " z", "double w", type + " x", type + " y"}, {}};
    test::PlyPart faces = test::PlyFaces({});
    for (std::uint64_t i = 0; i < 9000; ++i) {
      const auto n = static_cast<double>(moved(i) % 120);
      const double big = type == "double" ? n / 7 : type.ends_with("int") ? n * 8000009 : n;
      vertices.rows.push_back({1, n, 0.5, 119 - n, big});
      std::vector<double> face{3};
      for (std::uint64_t k = 0; k < 3; ++k) {
        face.push_back(static_cast<double>(moved((3 * i + k) % 9000)));
      }
      faces.rows.push_back(face);
    }
    for (const std::string format : test::kPlyFormats) {
      const std::string bytes = test::MakePly(format, {vertices, faces});
      const WholeMesh expected = MustRead(bytes);
      for (const std::uint64_t budget : {50000, 20000}) {
        ExpectSame(MustRead(bytes, Within(budget, scratch)), expected, type + " " + format);
      }
    }
  }
}

// What a reader delivers before it fails, and how it fails.
struct Ending {
  WholeMesh mesh;
  std::string message;
  ErrorCode code = ErrorCode::kInternal;
};

Ending ReadToEnding(Result<std::unique_ptr<MeshReader>> reader) {
  Ending ending;
  const auto fail = [&](const Error& error) {
    ending.message = error.message;
    ending.code = error.code;
    return ending;
  };
  if (!reader) return fail(reader.error());
  TriangleBatch batch(100);
  for (;;) {
    const auto n = (*reader)->Read(batch);
    if (!n) return fail(n.error());
    if (*n == 0) return ending;
    for (std::size_t i = 0; i < *n; ++i) {
      ending.mesh.triangles.push_back({batch.corner(i, 0), batch.corner(i, 1), batch.corner(i, 2)});
      ending.mesh.ids.push_back(batch.ids()[i]);
    }
  }
}

TEST(FarVertices, LeaveErrorsWhereTheyAre) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kAllShuffled, true);
  for (const std::string format : test::kSoupFormats) {
    const std::string whole = test::SoupBytes(soup, format);
    // Cut, damaged, and with something behind the end.
    std::vector<std::string> wrong = {whole.substr(0, whole.size() - 5), whole + "x 1 y\n"};
    for (const double at : {0.3, 0.6, 0.9, 0.99}) {
      wrong.push_back(whole);
      wrong.back()[static_cast<std::size_t>(at * static_cast<double>(whole.size()))] = '\x7f';
    }
    for (std::size_t k = 0; k < wrong.size(); ++k) {
      const Ending expected = ReadToEnding(OpenMesh(MemorySource(wrong[k], "mesh")));
      for (const std::uint64_t budget : BudgetsFor(soup)) {
        const Ending ending =
            ReadToEnding(OpenMesh(MemorySource(wrong[k], "mesh"), Within(budget, scratch)));
        EXPECT_EQ(ending.message, expected.message) << format << " " << k << " " << budget;
        EXPECT_EQ(ending.code, expected.code);
        EXPECT_TRUE(ending.mesh.ids == expected.mesh.ids);
        EXPECT_TRUE(ending.mesh.triangles == expected.mesh.triangles);
      }
    }
  }
}

TEST(FarVertices, AreRefusedWithEveryPrefixOfTheirFile) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(3000, Order::kAllShuffled, false);
  const std::string whole = test::SoupBytes(soup, "binary_little_endian");
  for (std::size_t n = whole.size() - 1; n > 300; n -= std::min<std::size_t>(n, 211)) {
    const std::string prefix = whole.substr(0, n);
    const Ending near = ReadToEnding(OpenMesh(MemorySource(prefix, "mesh")));
    const Ending far = ReadToEnding(OpenMesh(MemorySource(prefix, "mesh"), Within(9000, scratch)));
    EXPECT_NE(far.message, "") << n;
    EXPECT_EQ(far.message, near.message) << n;
    EXPECT_EQ(far.code, near.code) << n;
  }
}

TEST(FarVertices, PassOnReadErrorsOfTheInput) {
  const Scratch scratch;
  for (const Order order : kOrders) {
    const Soup soup = test::SphereSoup(kTriangles, order, false);
    for (const std::string format : {"binary_little_endian", "obj"}) {
      const std::string bytes = test::SoupBytes(soup, format);
      const WholeMesh expected = MustRead(bytes);
      for (std::uint64_t at = 1000; at < bytes.size(); at += bytes.size() / 23) {
        auto source = std::make_unique<test::FailingSource>(MemorySource(bytes, "mesh"), at);
        const Ending ending =
            ReadToEnding(OpenMesh(std::move(source), Within(soup.vertices.size() * 3, scratch)));
        EXPECT_EQ(ending.code, ErrorCode::kIo) << at;
        EXPECT_NE(ending.message.find("injected"), std::string::npos) << ending.message;
        const auto n = static_cast<std::ptrdiff_t>(ending.mesh.triangles.size());
        ASSERT_LE(ending.mesh.triangles.size(), expected.triangles.size());
        EXPECT_TRUE(std::equal(ending.mesh.triangles.begin(), ending.mesh.triangles.end(),
                               expected.triangles.begin(), expected.triangles.begin() + n));
      }
    }
  }
}

TEST(FarVertices, JoinOnlyIndicesThatJump) {
  Scratch scratch;
  for (const Order order : kOrders) {
    const Soup soup = test::SphereSoup(kTriangles, order, false);
    const std::string bytes = test::SoupBytes(soup, "binary_little_endian");
    auto reader = OpenMesh(MemorySource(bytes), Within(soup.vertices.size() * 12 / 8, scratch));
    ASSERT_TRUE(reader) << reader.error().message;
    // A join needs scratch files, a window over vertices in the input needs none.
    std::filesystem::remove_all(scratch.folder->path());
    const auto mesh = ReadWhole(**reader);
    EXPECT_EQ(mesh.has_value(), order == Order::kCoherent);
    if (mesh) continue;
    EXPECT_EQ(mesh.error().code, ErrorCode::kIo);
    EXPECT_NE(mesh.error().message.find(scratch.folder->path()), std::string::npos)
        << mesh.error().message;
  }
}

TEST(FarVertices, SayWhichScratchFolderIsFull) {
  if (geteuid() != 0) GTEST_SKIP() << "only root may mount a file system of fixed size";
  const test::TempFolder folder;
  if (mount("tmpfs", folder.path().c_str(), "tmpfs", 0, "size=250k") != 0) {
    GTEST_SKIP() << "a tmpfs cannot be mounted here";
  }
  {
    auto scratch = ScratchFolder::Open(folder.path());
    ASSERT_TRUE(scratch);
    const Soup soup = test::SphereSoup(kTriangles, Order::kAllShuffled, false);
    OpenOptions options;
    options.vertex_budget = 65536;
    options.scratch = scratch->get();
    // PLY fails when it joins, OBJ when it copies its vertices.
    for (const std::string format : {"binary_little_endian", "obj"}) {
      const Ending ending =
          ReadToEnding(OpenMesh(MemorySource(test::SoupBytes(soup, format)), options));
      EXPECT_EQ(ending.code, ErrorCode::kIo);
      EXPECT_NE(ending.message.find(folder.path()), std::string::npos) << ending.message;
      EXPECT_NE(ending.message.find("No space left"), std::string::npos) << ending.message;
    }
  }
  umount2(folder.path().c_str(), MNT_DETACH);
}

TEST(FarVertices, CancelWhileTheyLookAhead) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kAllShuffled, false);
  RunContext context;
  OpenOptions options = Within(soup.vertices.size() * 12 / 8, scratch);
  options.context = &context;
  auto reader = OpenMesh(MemorySource(test::SoupBytes(soup, "binary_big_endian")), options);
  ASSERT_TRUE(reader) << reader.error().message;
  context.Cancel();
  const Ending ending = ReadToEnding(std::move(reader));
  EXPECT_EQ(ending.code, ErrorCode::kCancelled);
  EXPECT_LT(ending.mesh.ids.size(), kTriangles / 2);
}

TEST(FarVertices, TakeTheirBudgetFromTheAccountAndGiveItBack) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kCoherent, false);
  const std::uint64_t bytes = soup.vertices.size() * 12;
  for (const std::string format : test::kSoupFormats) {
    const std::string file = test::SoupBytes(soup, format);
    for (const std::uint64_t budget : {bytes / 4, 8 * bytes}) {
      MemoryAccount account(budget);
      OpenOptions options;
      options.memory = &account;
      options.scratch = scratch.folder.get();
      {
        auto reader = OpenMesh(MemorySource(file), options);
        ASSERT_TRUE(reader) << reader.error().message;
        const bool far = budget < bytes;
        EXPECT_EQ((*reader)->vertices().size() == 0, far) << format;
        EXPECT_LE(account.taken(), budget);
        EXPECT_GE(account.taken(), far ? budget : bytes);
        EXPECT_TRUE(ReadWhole(**reader));
      }
      EXPECT_EQ(account.taken(), 0u);
    }
  }
}

TEST(FarVertices, SayHowManyBytesTheyNeed) {
  const Scratch scratch;
  const Soup soup = test::SphereSoup(kTriangles, Order::kCoherent, false);
  OpenOptions no_scratch;
  no_scratch.vertex_budget = 100000;
  const Ending obj =
      ReadToEnding(OpenMesh(MemorySource(test::SoupBytes(soup, "obj"), "mesh"), no_scratch));
  EXPECT_EQ(obj.code, ErrorCode::kOverBudget);
  EXPECT_NE(obj.message.find("mesh: the vertices need more than 1"), std::string::npos)
      << obj.message;
  // Vertices in a plain file need no scratch space.
  const std::string ply = test::SoupBytes(soup, "binary_little_endian");
  ExpectSame(MustRead(ply, no_scratch), MustRead(ply), "without scratch");
  const Ending tiny = ReadToEnding(OpenMesh(MemorySource(ply, "mesh"), Within(1000, scratch)));
  EXPECT_EQ(tiny.code, ErrorCode::kOverBudget);
  EXPECT_NE(tiny.message.find("bytes, its budget is 1000"), std::string::npos) << tiny.message;
}

}  // namespace
}  // namespace strata::io
