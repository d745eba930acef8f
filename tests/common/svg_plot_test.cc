#include "common/svg_plot.h"

#include <cstdio>
#include <limits>
#include <string>
#include <vector>

#include "common/html_page.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

size_t Count(const std::string& text, const std::string& part) {
  size_t count = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

// The line's own path, not a band's.
std::string LinePath(const std::string& svg) {
  const size_t end = svg.find("\" fill=\"none\""), start = svg.rfind("d=\"", end) + 3;
  return svg.substr(start, end - start);
}

TEST(LinePlot, LeavesOutOfLogarithmicAxesWhatIsNotPositive) {
  LinePlotOptions options;
  options.log_x = options.log_y = true;
  const std::string svg =
      LinePlot({{"a", "#000", {0, 1, 10, 100, 1000}, {5, 1, -1, 100, 1000}}}, options);
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_THAT(svg, Not(HasSubstr("inf")));
  EXPECT_EQ(Count(LinePath(svg), "M"), 2u);  // a gap at -1
  EXPECT_EQ(Count(LinePath(svg), "L"), 1u);
}

TEST(LinePlot, PutsDecadesAtEqualDistances) {
  LinePlotOptions options;
  options.log_x = true;
  const std::string path = LinePath(LinePlot({{"a", "#000", {1, 10, 100}, {0, 1, 2}}}, options));
  double x[3], y[3];
  ASSERT_EQ(std::sscanf(path.c_str(), "M%lf %lfL%lf %lfL%lf %lf", &x[0], &y[0], &x[1], &y[1], &x[2],
                        &y[2]),
            6);
  EXPECT_NEAR(x[1] - x[0], x[2] - x[1], 0.11);  // a tenth of a pixel is written
}

TEST(LinePlot, DrawsABandBehindItsLine) {
  LineSeries line{"a", "#000", {0, 1, 2}, {1, 2, 3}, {0, 1, kNan}, {2, 3, kNan}, "4 3"};
  const std::string svg = LinePlot({line}, {});
  EXPECT_LT(svg.find("fill-opacity"), svg.find("fill=\"none\""));
  EXPECT_THAT(svg, HasSubstr("stroke-dasharray=\"4 3\""));
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
}

TEST(BarPlot, ScalesBarsToTheLargestAndMarksReferences) {
  BarPlotOptions options;
  options.references = {{2, "limit <1>"}};
  const std::string svg =
      BarPlot({{"half", "#111111", "", 4}, {"whole", "#222222", "", 8}}, options);
  const auto width = [&](const std::string& color) {
    const size_t end = svg.find("fill=\"" + color), start = svg.rfind("width=\"", end) + 7;
    return std::stod(svg.substr(start));
  };
  EXPECT_NEAR(width("#111111") * 2, width("#222222"), 0.2);
  EXPECT_THAT(svg, HasSubstr("limit &lt;1&gt;"));
  EXPECT_THAT(svg, HasSubstr("stroke-dasharray"));
}

TEST(BarPlot, DrawsNothingOfWhatIsNoNumber) {
  EXPECT_THAT(BarPlot({{"none", "#111111", "", kNan}, {"one", "#222222", "", 1}}, {}),
              Not(HasSubstr("#111111")));
}

TEST(PageHead, FollowsDarkScreensAndPrintsOnWhite) {
  const std::string head = PageHead("a <b>");
  EXPECT_THAT(head, HasSubstr("<title>a &lt;b&gt;</title>"));
  EXPECT_THAT(head, HasSubstr("@media screen and (prefers-color-scheme:dark)"));
  EXPECT_THAT(head, HasSubstr("@media print"));
  for (const char* color : {kSvgInk, kSvgMuted, kSvgGrid})
    EXPECT_THAT(head, HasSubstr(std::string("=\"") + color + "\"]"));
}

}  // namespace
}  // namespace robostress
