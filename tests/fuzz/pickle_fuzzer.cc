// The pickle inside LIBERO's initial states, under a correct checksum.
#include "tests/common/libero/init_file.h"
#include "tests/fuzz/init_state_checks.h"
#include "tests/fuzz/splice_mutator.h"

namespace {

// Bytes of the opcode at `at` with its argument, as pickle protocol 2 lays them out.
size_t OpcodeSize(const uint8_t* data, size_t size, size_t at) {
  switch (data[at]) {
    case 0x80:  // PROTO
    case 'K':   // BININT1
    case 'q':   // BINPUT
    case 'h':   // BINGET
      return 2;
    case 'M':  // BININT2
      return 3;
    case 'J':  // BININT
      return 5;
    case 'X': {  // BINUNICODE
      size_t length = 0;
      for (size_t i = 4; i > 0 && at + i < size; --i) length = length << 8 | data[at + i];
      return 5 + length;
    }
    case 'c': {  // GLOBAL
      size_t end = at, lines = 0;
      while (end < size && lines < 2) lines += data[end++] == '\n';
      return end - at;
    }
    default:
      return 1;
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress::libero;
  CheckInitStatesOf(Zip("archive/data.pkl", {reinterpret_cast<const char*>(data), size}));
  return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max_size,
                                          unsigned int seed) {
  std::vector<size_t> opcodes;
  for (size_t at = 0; at < size; at += OpcodeSize(data, size, at)) opcodes.push_back(at);
  return robostress::MutateBetween(opcodes, data, size, max_size, seed);
}
