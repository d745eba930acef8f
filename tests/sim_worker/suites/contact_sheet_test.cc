#include "sim_worker/contact_sheet.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "absl/strings/escaping.h"
#include "common/image.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

FirstFrame Frame(const std::string& instruction, uint8_t grey) {
  return {instruction, Image{64, 64, std::vector<uint8_t>(size_t{3} * 64 * 64, grey)}};
}

int Count(const std::string& text, const std::string& part) {
  int count = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

TEST(ContactSheet, HoldsEachPictureWithItsNumberAndInstruction) {
  std::vector<FirstFrame> frames;
  for (int i = 0; i < 7; ++i) frames.push_back(Frame("task", static_cast<uint8_t>(30 * i)));
  const absl::StatusOr<std::string> svg = ContactSheetSvg("a suite", frames);
  ASSERT_TRUE(svg.ok()) << svg.status();
  EXPECT_EQ(Count(*svg, "<image "), 7);
  EXPECT_THAT(*svg, HasSubstr(">a suite</text>"));
  EXPECT_THAT(*svg, HasSubstr(">6 task</text>"));
  EXPECT_THAT(*svg, HasSubstr(absl::Base64Escape(*EncodePng(frames[6].image))));
  // Five in a row: the sixth starts a second one below the first.
  EXPECT_EQ(Count(*svg, "<image x=\"12\""), 2);
}

TEST(ContactSheet, WrapsAndEscapesInstructions) {
  const absl::StatusOr<std::string> svg =
      ContactSheetSvg("t", {Frame("put <the> pot & lid away", 0)});
  ASSERT_TRUE(svg.ok()) << svg.status();
  EXPECT_THAT(*svg, HasSubstr("&lt;the&gt;"));
  EXPECT_THAT(*svg, HasSubstr("&amp;"));
  EXPECT_THAT(*svg, Not(HasSubstr("pot & lid")));
  EXPECT_GE(Count(*svg, "<text "), 3) << "64 px hold about nine characters";
}

TEST(ContactSheet, RendersTheTasksOfASuiteInTheirOrder) {
  UnitConfig unit;
  unit.suite = "tabletop_object";
  const auto frames = RenderFirstFrames(unit, /*initial_state=*/0, /*size=*/48);
  ASSERT_TRUE(frames.ok()) << frames.status();
  ASSERT_EQ(frames->size(), 10u);
  for (const FirstFrame& frame : *frames) {
    EXPECT_EQ(frame.image.width, 48);
    EXPECT_EQ(frame.image.height, 48);
    ASSERT_EQ(frame.image.data.size(), size_t{3} * 48 * 48);
    const auto [low, high] = std::minmax_element(frame.image.data.begin(), frame.image.data.end());
    EXPECT_GT(*high - *low, 100) << "a picture, not an empty frame";
  }
  EXPECT_NE((*frames)[0].instruction, (*frames)[1].instruction);
}

TEST(ContactSheet, NamesWhatItCannotRender) {
  UnitConfig unit;
  unit.suite = "tabletop_gaol";
  EXPECT_THAT(std::string(RenderFirstFrames(unit, 0, 48).status().message()),
              HasSubstr("'tabletop_gaol' is unknown"));
}

}  // namespace
}  // namespace robostress
