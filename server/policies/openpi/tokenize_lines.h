#pragma once

#include <string>

namespace robostress::openpi {

// Loads the SentencePiece model at this path, then writes a line of JSON for each line of standard
// input; false where it is no model. A unit of its own: SentencePiece declares names of absl that
// ours declares otherwise.
bool TokenizeLines(const std::string& model);

}  // namespace robostress::openpi
