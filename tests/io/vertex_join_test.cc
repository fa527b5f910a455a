// The parts that vertices on disk are served by, against an array in memory.
#include "io/vertex_join.h"

#include <gtest/gtest.h>

#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "io/vertex_file.h"
#include "io/vertex_window.h"
#include "tests/support/temp_folder.h"

namespace strata::io {
namespace {

class OnDisk : public ::testing::Test {
 protected:
  OnDisk() : scratch_(*ScratchFolder::Open(folder_.path())), file_(*scratch_) {}

  void Fill(std::uint64_t n, bool as_double) {
    std::vector<float> f32;
    std::vector<double> f64;
    for (std::uint64_t i = 0; i < 3 * n; ++i) {
      f32.push_back(static_cast<float>(i) / 4);
      f64.push_back(static_cast<double>(i) / 3);
    }
    ASSERT_TRUE(file_.Append(as_double ? VertexView{{}, f64} : VertexView{f32, {}}));
  }
  double Expected(std::uint64_t i) const {
    const auto n = static_cast<double>(3 * i);
    return file_.is_double() ? n / 3 : static_cast<double>(static_cast<float>(3 * i) / 4);
  }
  double First(const char* vertex) const {
    float f = 0;
    double d = 0;
    if (file_.is_double()) {
      std::memcpy(&d, vertex, sizeof d);
      return d;
    }
    std::memcpy(&f, vertex, sizeof f);
    return static_cast<double>(f);
  }

  test::TempFolder folder_;
  std::unique_ptr<ScratchFolder> scratch_;
  ScratchVertices file_;
};

TEST_F(OnDisk, StaysFloatUntilADoubleComes) {
  const std::vector<float> f32 = {1, 2, 3, 4, 5, 6};
  const std::vector<double> f64 = {0.1, 0.2, 0.3};
  ASSERT_TRUE(file_.Append({f32, {}}));
  EXPECT_FALSE(file_.is_double());
  ASSERT_TRUE(file_.Append({{}, f64}));
  ASSERT_TRUE(file_.Append({f32, {}}));
  EXPECT_TRUE(file_.is_double());
  ASSERT_EQ(file_.size(), 5u);
  std::vector<double> all(15);
  ASSERT_TRUE(file_.Load(0, {reinterpret_cast<char*>(all.data()), 15 * sizeof(double)}));
  EXPECT_EQ(all, (std::vector<double>{1, 2, 3, 4, 5, 6, 0.1, 0.2, 0.3, 1, 2, 3, 4, 5, 6}));
}

class InEachPrecision : public OnDisk, public ::testing::WithParamInterface<bool> {};

TEST_P(InEachPrecision, WindowFindsEveryVertex) {
  constexpr std::uint64_t kCount = 1 << 16;  // The last page is a whole one.
  Fill(kCount, GetParam());
  for (const std::uint64_t budget : {VertexWindow::LeastBudget(file_), std::uint64_t{100000}}) {
    VertexWindow window(file_, budget);
    EXPECT_LE(window.bytes(), budget);
    std::mt19937_64 random(7);
    for (int i = 0; i < 20000; ++i) {
      const std::uint64_t at = random() % kCount;
      ASSERT_EQ(First(window.Find(at)), Expected(at));
    }
    const std::uint64_t before = window.faults();
    for (std::uint64_t i = 0; i < kCount; ++i) ASSERT_EQ(First(window.Find(i)), Expected(i));
    // In order, each page is read once at most.
    EXPECT_LE(window.faults() - before, kCount * file_.vertex_bytes() / window.page_bytes() + 1);
    EXPECT_FALSE(window.failed());
  }
}

TEST_P(InEachPrecision, JoinAnswersInTheOrderOfAsking) {
  constexpr std::uint64_t kCount = 40000;
  Fill(kCount, GetParam());
  for (const std::uint64_t budget : {70000, 120000, 300000, 10000000}) {
    ASSERT_TRUE(VertexJoin::Fits(file_, budget));
    VertexJoin join(file_, *scratch_, budget);
    std::mt19937_64 random(budget);
    for (const std::size_t asked : {0, 1, 777, 100000}) {
      std::vector<std::uint64_t> indices(asked);
      for (std::uint64_t& i : indices) i = random() % kCount;
      if (asked == 777) std::fill(indices.begin(), indices.end(), kCount - 1);
      ASSERT_TRUE(join.BeginRecord());
      for (const std::uint64_t i : indices) join.Record(i);
      EXPECT_EQ(join.recorded(), asked);
      ASSERT_TRUE(join.Resolve(nullptr));
      for (const std::uint64_t i : indices) ASSERT_EQ(First(join.Next(i)), Expected(i));
      EXPECT_EQ(join.taken(), asked);
      EXPECT_FALSE(join.failed());
    }
  }
}

TEST_P(InEachPrecision, JoinNoticesQuestionsThatWereNotAsked) {
  Fill(40000, GetParam());
  VertexJoin join(file_, *scratch_, 100000);
  ASSERT_TRUE(join.BeginRecord());
  for (std::uint64_t i = 0; i < 5000; ++i) join.Record(i);
  ASSERT_TRUE(join.Resolve(nullptr));
  for (std::uint64_t i = 0; i < 6000; ++i) join.Next(39999);
  ASSERT_TRUE(join.failed());
  EXPECT_EQ(join.failure().value().code, ErrorCode::kIo);
}

TEST_P(InEachPrecision, JoinStopsWhenCancelled) {
  Fill(40000, GetParam());
  VertexJoin join(file_, *scratch_, 100000);
  ASSERT_TRUE(join.BeginRecord());
  for (std::uint64_t i = 0; i < 200000; ++i) join.Record(i % 40000);
  RunContext context;
  context.Cancel();
  const auto resolved = join.Resolve(&context);
  ASSERT_FALSE(resolved);
  EXPECT_EQ(resolved.error().code, ErrorCode::kCancelled);
}

INSTANTIATE_TEST_SUITE_P(Vertices, InEachPrecision, ::testing::Bool());

}  // namespace
}  // namespace strata::io
