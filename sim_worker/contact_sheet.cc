#include "sim_worker/contact_sheet.h"

#include <algorithm>
#include <memory>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "common/check.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "sim_worker/sim_task.h"

namespace robostress {
namespace {

constexpr int kColumns = 5;
// Of the page [px].
constexpr int kGap = 12, kTitleHeight = 36, kFontSize = 13, kLineHeight = 16;
// Of sans-serif text, rather too wide than too narrow.
constexpr double kCharacterWidth = 0.56 * kFontSize;

// The leftmost square of a wide image.
Image LeftSquare(const Image& image) {
  Image square{image.height, image.height, {}};
  for (int row = 0; row < image.height; ++row) {
    const auto first = image.data.begin() + size_t{3} * row * image.width;
    square.data.insert(square.data.end(), first, first + size_t{3} * image.height);
  }
  return square;
}

std::vector<std::string> WrapWords(const std::string& text, size_t columns) {
  std::vector<std::string> lines = {""};
  for (const absl::string_view word : absl::StrSplit(text, ' ')) {
    if (!lines.back().empty() && lines.back().size() + 1 + word.size() > columns) {
      lines.emplace_back();
    }
    absl::StrAppend(&lines.back(), lines.back().empty() ? "" : " ", word);
  }
  return lines;
}

std::string Text(int x, int y, const std::string& style, const std::string& text) {
  return absl::StrFormat("<text x=\"%d\" y=\"%d\"%s>%s</text>\n", x, y, style,
                         absl::StrReplaceAll(text, {{"&", "&amp;"}, {"<", "&lt;"}, {">", "&gt;"}}));
}

}  // namespace

absl::StatusOr<FirstFrame> RenderFirstFrame(const UnitConfig& unit, int task, int size) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<SimTask> sim, MakeSimTask(unit, task));
  RS_RETURN_IF_ERROR(sim->Reset(unit.first_initial_state));
  RS_ASSIGN_OR_RETURN(const Image film, sim->Film(2 * size));
  return FirstFrame{sim->instruction(), ResizeArea(LeftSquare(film), size, size)};
}

absl::StatusOr<std::string> ContactSheetSvg(const std::string& title,
                                            const std::vector<FirstFrame>& frames) {
  RS_CHECK(!frames.empty());
  const int size = frames.front().image.width;
  std::vector<std::vector<std::string>> captions;
  size_t lines = 1;
  for (size_t i = 0; i < frames.size(); ++i) {
    captions.push_back(WrapWords(absl::StrCat(i, " ", frames[i].instruction),
                                 static_cast<size_t>(size / kCharacterWidth)));
    lines = std::max(lines, captions.back().size());
  }
  const int cell_height = size + static_cast<int>(lines) * kLineHeight + 2 * kGap;
  const int rows = (static_cast<int>(frames.size()) + kColumns - 1) / kColumns;
  const int width = kColumns * (size + kGap) + kGap, height = kTitleHeight + rows * cell_height;
  std::string svg = absl::StrFormat(
      "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%1$d\" height=\"%2$d\" viewBox=\"0 0 %1$d "
      "%2$d\" font-family=\"sans-serif\" font-size=\"%3$d\">\n<rect width=\"100%%\" "
      "height=\"100%%\" fill=\"white\"/>\n",
      width, height, kFontSize);
  svg += Text(kGap, 24, " font-size=\"16\" font-weight=\"bold\"", title);
  for (size_t i = 0; i < frames.size(); ++i) {
    const int x = kGap + static_cast<int>(i % kColumns) * (size + kGap);
    const int y = kTitleHeight + static_cast<int>(i / kColumns) * cell_height;
    RS_ASSIGN_OR_RETURN(const std::string png, EncodePng(frames[i].image));
    absl::StrAppendFormat(&svg,
                          "<image x=\"%d\" y=\"%d\" width=\"%d\" height=\"%d\" "
                          "href=\"data:image/png;base64,%s\"/>\n",
                          x, y, size, size, absl::Base64Escape(png));
    for (size_t k = 0; k < captions[i].size(); ++k)
      svg += Text(x, y + size + static_cast<int>(k + 1) * kLineHeight, "", captions[i][k]);
  }
  return svg + "</svg>\n";
}

}  // namespace robostress
