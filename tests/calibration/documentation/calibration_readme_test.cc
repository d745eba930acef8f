#include <string>

#include "calibration/model/effect_table.h"
#include "calibration/search/calibration_report.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;

std::string Page(const std::string& path) {
  return ReadFile(std::string(ROBOSTRESS_SOURCE_DIR) + "/docs/" + path).value();
}

TEST(CalibrationPages, HoldTheEffectLibraryAsItIs) {
  const std::string begin = "<!-- robostress calibrate --effects -->\n";
  const std::string page = Page("results/calibration-effects.md");
  const size_t start = page.find(begin);
  ASSERT_NE(start, std::string::npos);
  const size_t end = page.find("\n\n", start);
  EXPECT_EQ(page.substr(start + begin.size(), end + 1 - start - begin.size()),
            EffectTableMarkdown())
      << "put the output of `robostress calibrate --effects` between the page's mark and its text";
}

TEST(CalibrationPages, ExplainEveryVerdict) {
  const std::string page = Page("calibrate-my-arm.md");
  for (const Verdict verdict :
       {Verdict::kAttributed, Verdict::kAmbiguous, Verdict::kReducedNotAttributed,
        Verdict::kUnattributed, Verdict::kDeclaredSufficient, Verdict::kNotTestable}) {
    EXPECT_THAT(page, HasSubstr(std::string("\n| `") + VerdictName(verdict) + "` |"));
  }
}

}  // namespace
}  // namespace robostress::calibration
