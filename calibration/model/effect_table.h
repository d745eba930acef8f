#pragma once

#include <string>

namespace robostress::calibration {

// The effect library as a Markdown table: type, stage, equation, parameters with units, what data
// must contain, what looks alike and the experiment that tells it apart.
std::string EffectTableMarkdown();

}  // namespace robostress::calibration
