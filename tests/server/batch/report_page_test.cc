#include "server/batch/report_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "server/batch/plots.h"

namespace strata::server {
namespace {

using testing::HasSubstr;
using testing::Not;

Report ReportOf(const std::string& name, bool sampled) {
  Report report;
  report.folders = {"out"};
  ReportRow row;
  row.folder = "out";
  row.line.path = name;
  row.line.sampled = sampled;
  row.line.area = 2;
  row.line.samples = 30;
  row.line.error_type = sampled ? "" : "corrupt-input";
  row.line.error_message = sampled ? "" : name + ": is broken";
  report.rows.push_back(row);
  ++(sampled ? report.sampled : report.failed);
  if (!sampled) ++report.reasons["corrupt-input"];
  return report;
}

TEST(ReportPage, NamesAndMessagesAreTextsWhateverTheyHold) {
  for (const bool sampled : {true, false}) {
    const std::string page =
        ReportPage(ReportOf("<script>alert('x')</script>\"onerror=\"\n\xff", sampled));
    EXPECT_THAT(page, Not(HasSubstr("<script>alert")));
    EXPECT_THAT(page, Not(HasSubstr("\"onerror")));
    EXPECT_THAT(page, HasSubstr("&lt;script&gt;alert(&#39;x&#39;)"));
    EXPECT_THAT(page, HasSubstr("\\n\\xff"));
  }
}

TEST(ReportPage, NamesNoAddress) {
  const std::string page = ReportPage(ReportOf("a", true));
  EXPECT_THAT(page, Not(HasSubstr("http://")));
  EXPECT_THAT(page, Not(HasSubstr("https://")));
  EXPECT_THAT(page, HasSubstr("default-src 'none'"));
}

TEST(Plots, StandTheOddValues) {
  const double odd[] = {0, -1, 1e-300, 1e300, 3};
  EXPECT_THAT(HistogramSvg(odd, "s"), HasSubstr("<rect"));
  EXPECT_THAT(HistogramSvg({}, "s"), Not(HasSubstr("<rect")));
  const PlotPoint points[] = {{0, 1, "a"}, {2, 3, "b"}};
  EXPECT_THAT(ScatterSvg(points, "x", "y"), HasSubstr("<circle"));
  EXPECT_THAT(ScatterSvg({}, "x", "y"), Not(HasSubstr("nan")));
}

}  // namespace
}  // namespace strata::server
