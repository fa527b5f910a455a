// A test that works in scratch space of its own.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <utility>

#include "core/scratch.h"
#include "tests/support/temp_folder.h"

namespace strata::test {

class ScratchTest : public testing::Test {
 protected:
  void SetUp() override {
    auto opened = ScratchFolder::Open(folder_.path());
    ASSERT_TRUE(opened) << opened.error().message;
    scratch_ = std::move(*opened);
    file_ = NewFile();
  }
  std::unique_ptr<ScratchFile> NewFile() {
    auto file = scratch_->NewFile();
    EXPECT_TRUE(file);
    return std::move(*file);
  }

  TempFolder folder_;
  std::unique_ptr<ScratchFolder> scratch_;
  std::unique_ptr<ScratchFile> file_;
};

}  // namespace strata::test
