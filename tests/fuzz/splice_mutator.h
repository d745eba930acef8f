#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace robostress {

// A structure-aware mutation for libFuzzer's LLVMFuzzerCustomMutator. `boundaries`: ascending
// offsets at which the input's tokens begin. A span between two of them is deleted, moved,
// repeated or repeated up to 2^16 times at a third, which finds what grows faster than its input;
// every second call changes bytes as libFuzzer does on its own. A function of
// (input, seed). Returns the new size, at most max_size.
size_t MutateBetween(const std::vector<size_t>& boundaries, uint8_t* data, size_t size,
                     size_t max_size, unsigned int seed);

}  // namespace robostress
