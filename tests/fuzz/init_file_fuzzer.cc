// The container of LIBERO's initial states: the whole file, checksum included.
#include "tests/fuzz/init_state_checks.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  robostress::libero::CheckInitStatesOf({reinterpret_cast<const char*>(data), size});
  return 0;
}
