#include "eval/report/error_model_plots.h"

#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(ErrorModelPictures, ShowInputHiddenStateAndOutputWithUnits) {
  const std::vector<ErrorModelPicture> pictures = DrawErrorModels();
  ASSERT_EQ(pictures.size(), 4u);
  for (const ErrorModelPicture& picture : pictures) {
    for (const char* text :
         {"Input: ", "idden state", "Output: ", "time [ms]", "nominal", "full severity (L5)"}) {
      EXPECT_THAT(picture.svg, HasSubstr(text)) << picture.name;
    }
    EXPECT_THAT(picture.svg, Not(HasSubstr("nan"))) << picture.name;
  }
}

TEST(ErrorModelPictures, OfTheDocumentationAreCurrent) {
  for (const ErrorModelPicture& picture : DrawErrorModels()) {
    const std::string path =
        ROBOSTRESS_SOURCE_DIR "/common/joint_errors/docs/" + picture.name + ".svg";
    const absl::StatusOr<std::string> file = ReadFile(path);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_TRUE(*file == picture.svg)
        << path << " differs; run: robostress error-models --out common/joint_errors/docs";
  }
}

}  // namespace
}  // namespace robostress
