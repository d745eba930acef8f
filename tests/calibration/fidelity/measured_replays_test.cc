#include "calibration/fidelity/measured_replays.h"

#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// Two replays of each kind; the loaded ones hang 5 mm lower while the object is held.
std::string Csv() {
  std::string text = "t,x,y,z,held,loaded,replay\n";
  for (const int loaded : {0, 1}) {
    for (const int replay : {0, 1}) {
      for (int i = 0; i <= 40; ++i) {
        const bool held = i >= 15 && i <= 35;
        absl::StrAppendFormat(&text, "%.2f,%.4f,0,%.4f,%d,%d,%d\n", 0.1 * i, 0.01 * i,
                              0.3 - (loaded && held ? 0.005 : 0), held, loaded, replay);
      }
    }
  }
  return text;
}

absl::StatusOr<MeasuredReplays> Read(const std::string& text) {
  const std::string dir =
      absl::StrCat(::testing::TempDir(), "/replays_",
                   ::testing::UnitTest::GetInstance()->current_test_info()->name());
  EXPECT_TRUE(MakeDirectories(dir).ok());
  EXPECT_TRUE(WriteFileAtomically(dir + "/replays.csv", text).ok());
  return ReadMeasuredReplays(dir);
}

std::string Message(const std::string& text) { return std::string(Read(text).status().message()); }

TEST(ReadMeasuredReplays, SortsRowsIntoReplays) {
  const auto measured = Read(Csv());
  ASSERT_TRUE(measured.ok()) << measured.status();
  EXPECT_EQ(measured->loaded.size(), 2u);
  EXPECT_EQ(measured->unloaded.size(), 2u);
  EXPECT_EQ(measured->loaded[1].t.size(), 41u);
}

TEST(ReadMeasuredReplays, ReadsWhatIsWritten) {
  const auto measured = Read(Csv());
  ASSERT_TRUE(measured.ok());
  EXPECT_EQ(WriteMeasuredReplays(*Read(WriteMeasuredReplays(*measured))),
            WriteMeasuredReplays(*measured));
}

TEST(ReadMeasuredReplays, NamesWhatDoesNotFit) {
  EXPECT_THAT(Message("t,x,y,held,loaded,replay\n0,0,0,0,0,0\n"), HasSubstr("no column 'z'"));
  EXPECT_THAT(Message(absl::StrReplaceAll(Csv(), {{"0.30,0.0300,", "0.30,nan,"}})),
              HasSubstr("replays.csv:5: x is 'nan'"));
  EXPECT_THAT(Message("t,x,y,z,held,loaded,replay\n0,0,0,0,2,0,0\n"), HasSubstr("must be 0 or 1"));
  EXPECT_THAT(Message("t,x,y,z,held,loaded,replay\n0,0,0,0,0,0,0\n0,0,0,0,0,0,0\n"),
              AllOf(HasSubstr("replays.csv:3"), HasSubstr("order of time")));
  EXPECT_THAT(Message("t,x,y,z,held,loaded,replay\n0,0,0\n"), HasSubstr("has 3 columns, not 7"));
  EXPECT_THAT(Message("t,x,y,z,held,loaded,replay\n"), HasSubstr("has no rows"));
  EXPECT_THAT(Message("t,x,y,z,held,loaded,replay\n0,0,0,0,0,0,1e300\n"),
              HasSubstr("must be a whole number from 0 to 1000000"));
  EXPECT_THAT(Message(absl::StrReplaceAll(Csv(), {{",1,1,", ",0,1,"}})),
              AllOf(HasSubstr("loaded replay 0"), HasSubstr("nothing is held")));
  EXPECT_FALSE(ReadMeasuredReplays(::testing::TempDir() + "/nowhere").ok());
}

TEST(MeasureProfiles, AreDeviationsFromTheMeanUnloadedPath) {
  const MeasuredProfiles profiles = MeasureProfiles(*Read(Csv())).value();
  ASSERT_EQ(profiles.loaded.size(), 2u);
  EXPECT_NEAR(profiles.loaded[0][10], 0, 1e-9);
  EXPECT_NEAR(profiles.loaded[0][75], 5e-3, 1e-9);
  EXPECT_NEAR(profiles.vertical[75], -5e-3, 1e-9);
  EXPECT_NEAR(profiles.unloaded[0][75], 0, 1e-9);
  EXPECT_NEAR(profiles.span.grasp, 1.5, 1e-9);
}

}  // namespace
}  // namespace robostress::calibration
