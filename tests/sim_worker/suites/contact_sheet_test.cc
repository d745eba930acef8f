#include "sim_worker/contact_sheet.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

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

TEST(ContactSheet, RendersEachTaskOfASuite) {
  UnitConfig unit;
  unit.suite = "tabletop_object";
  std::set<std::string> instructions;
  for (int task = 0; task < 10; ++task) {
    const absl::StatusOr<FirstFrame> frame = RenderFirstFrame(unit, task, /*size=*/48);
    ASSERT_TRUE(frame.ok()) << frame.status();
    const Image& image = frame->image;
    EXPECT_EQ(image.width, 48);
    EXPECT_EQ(image.height, 48);
    ASSERT_EQ(image.data.size(), size_t{3} * 48 * 48);
    const auto [low, high] = std::minmax_element(image.data.begin(), image.data.end());
    EXPECT_GT(*high - *low, 100) << "a picture, not an empty frame";
    instructions.insert(frame->instruction);
  }
  EXPECT_EQ(instructions.size(), 10u);
}

TEST(ContactSheet, NamesWhatItCannotRender) {
  UnitConfig unit;
  unit.suite = "tabletop_gaol";
  EXPECT_THAT(std::string(RenderFirstFrame(unit, 0, 48).status().message()),
              HasSubstr("'tabletop_gaol' is unknown"));
}

}  // namespace
}  // namespace robostress
