#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/types.h"
#include "common/unit_config.h"

namespace robostress {

// What one task of a suite looks like when its episode starts.
struct FirstFrame {
  std::string instruction;
  Image image;  // third-person view
};

// The first frame of a task of `unit.suite` from `unit.first_initial_state`, size x size [px],
// averaged from twice that.
absl::StatusOr<FirstFrame> RenderFirstFrame(const UnitConfig& unit, int task, int size);

// A page of frames of equal size, five in a row, each with its number and instruction below it: an
// SVG that holds its pictures. `title` stands above.
absl::StatusOr<std::string> ContactSheetSvg(const std::string& title,
                                            const std::vector<FirstFrame>& frames);

}  // namespace robostress
