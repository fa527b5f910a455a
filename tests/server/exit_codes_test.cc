#include "server/exit_codes.h"

#include <gtest/gtest.h>

#include <set>
#include <string>

#include "server/option_table.h"
#include "tests/support/read_text.h"

namespace strata::server {
namespace {

TEST(ExitCodes, EveryErrorCodeHasItsRow) {
  for (int i = 0; i < kErrorCodeCount; ++i) {
    const auto code = static_cast<ErrorCode>(i);
    EXPECT_EQ(ExitCodeOf(code).code, code);
  }
}

TEST(ExitCodes, TellFailuresApartInEveryProtocol) {
  std::set<int> exits, grpc;
  for (const ExitCode& row : kExitCodes) {
    EXPECT_TRUE(exits.insert(row.exit_status).second) << row.meaning;
    EXPECT_TRUE(grpc.insert(row.grpc_status).second) << row.meaning;
    EXPECT_GE(row.exit_status, 2) << "0 is success, 1 is what shells say themselves";
    EXPECT_LE(row.exit_status, 130);
    EXPECT_GE(row.http_status, 400);
    EXPECT_LE(row.http_status, 599);
    EXPECT_GE(row.grpc_status, 1);
    EXPECT_LE(row.grpc_status, 16);
  }
}

TEST(ExitCodes, StandInHelpAndReadme) {
  const std::string help = ExitCodesText();
  const std::string readme = test::ReadText(STRATA_SOURCE_DIR "/README.md");
  for (const ExitCode& row : kExitCodes) {
    EXPECT_NE(help.find(std::to_string(row.exit_status) + "  " + row.meaning), std::string::npos);
    const std::string in_table = "| " + std::to_string(row.exit_status) + " | ";
    EXPECT_NE(readme.find(in_table), std::string::npos) << in_table;
  }
}

}  // namespace
}  // namespace strata::server
