#include "server/human_units.h"

#include <gtest/gtest.h>

#include <cmath>

namespace strata::server {
namespace {

TEST(HumanUnits, GroupsDigitsByThree) {
  EXPECT_EQ(Grouped(0), "0");
  EXPECT_EQ(Grouped(999), "999");
  EXPECT_EQ(Grouped(1000), "1,000");
  EXPECT_EQ(Grouped(~std::uint64_t{0}), "18,446,744,073,709,551,615");
}

TEST(HumanUnits, SiKeepsThreeDigits) {
  EXPECT_EQ(Si(0), "0 ");
  EXPECT_EQ(Si(7), "7 ");
  EXPECT_EQ(Si(999), "999 ");
  EXPECT_EQ(Si(999.9), "1.00 k");
  EXPECT_EQ(Si(1234567), "1.23 M");
  EXPECT_EQ(Si(12345678), "12.3 M");
  EXPECT_EQ(Si(999'999), "1.00 M");
  EXPECT_EQ(Si(NAN), "0 ");
  EXPECT_EQ(Si(INFINITY), "0 ");
}

TEST(HumanUnits, SecondsGrowIntoHours) {
  EXPECT_EQ(Seconds(0.421), "0.42 s");
  EXPECT_EQ(Seconds(12.34), "12.3 s");
  EXPECT_EQ(Seconds(59.97), "1 min 00 s");
  EXPECT_EQ(Seconds(185), "3 min 05 s");
  EXPECT_EQ(Seconds(7620), "2 h 07 min");
  EXPECT_EQ(Seconds(-1), "0.00 s");
  EXPECT_EQ(Seconds(NAN), "0.00 s");
  EXPECT_EQ(Seconds(1e300), "over 30 years");
}

}  // namespace
}  // namespace strata::server
