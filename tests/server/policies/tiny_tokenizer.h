#pragma once

#include <cstdlib>

namespace robostress::openpi {

inline constexpr char kTinyTokenizer[] = TINY_TOKENIZER;  // data/README.md

// Lets this test find robostress-tokenize, which lies beside the other programs.
inline void UseBuiltPrograms() { setenv("ROBOSTRESS_BIN", PROGRAM_FOLDER, 1); }

}  // namespace robostress::openpi
