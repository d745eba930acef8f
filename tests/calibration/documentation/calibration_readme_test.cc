#include <string>

#include "calibration/model/effect_table.h"
#include "calibration/search/calibration_report.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

using ::testing::HasSubstr;

std::string Readme() {
  return ReadFile(std::string(ROBOSTRESS_SOURCE_DIR) + "/calibration/README.md").value();
}

TEST(CalibrationReadme, HoldsTheEffectLibraryAsItIs) {
  const std::string begin = "<!-- robostress calibrate --effects -->\n";
  const std::string readme = Readme();
  const size_t start = readme.find(begin);
  ASSERT_NE(start, std::string::npos);
  const size_t end = readme.find("\n\n", start);
  EXPECT_EQ(readme.substr(start + begin.size(), end + 1 - start - begin.size()),
            EffectTableMarkdown())
      << "put the output of `robostress calibrate --effects` into calibration/README.md";
}

TEST(CalibrationReadme, ExplainsEveryVerdict) {
  const std::string readme = Readme();
  for (const Verdict verdict :
       {Verdict::kAttributed, Verdict::kAmbiguous, Verdict::kReducedNotAttributed,
        Verdict::kUnattributed, Verdict::kDeclaredSufficient, Verdict::kNotTestable}) {
    EXPECT_THAT(readme, HasSubstr(std::string("\n| `") + VerdictName(verdict) + "` |"));
  }
}

}  // namespace
}  // namespace robostress::calibration
