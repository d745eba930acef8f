// `robostress close-loop --arm piper`, where this build has the emulated Piper.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

TEST(ClosePiperLoop, SaysWhatAPiperCannotHide) {
  const std::string root =
      (fs::path(testing::TempDir()) / absl::StrCat("close_piper_loop_", getpid())).string();
  fs::create_directories(root);
  const std::string hidden = root + "/seventh.yaml";
  ASSERT_TRUE(
      WriteFileAtomically(hidden, "joints: [{name: J7, effects: [{type: backlash, B: 0.01}]}]\n")
          .ok());
  const auto [output, code] = RunProgram(
      CLOSE_LOOP, absl::StrCat("--arm piper --hidden ", hidden, " --out ", root, "/circle"));
  EXPECT_NE(code, 0);
  EXPECT_THAT(output, HasSubstr("J7"));
  EXPECT_FALSE(fs::exists(root + "/circle/summary.json"));
  fs::remove_all(root);
}

}  // namespace
}  // namespace robostress
