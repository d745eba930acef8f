#pragma once

#include <string>
#include <vector>

namespace robostress {

// One joint error model over time, driven at the simulator's 2 ms: what goes in, the hidden state,
// what comes out, at nominal and at full (L5) severity.
struct ErrorModelPicture {
  std::string name;  // "friction", of the file
  std::string svg;
};

// Friction, gravity residual, backlash, compliance.
std::vector<ErrorModelPicture> DrawErrorModels();

}  // namespace robostress
