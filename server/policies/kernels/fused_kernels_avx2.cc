// Compiled with -mavx2 -mfma where the processor family has them.
#if defined(__x86_64__)
#include "server/policies/kernels/fused_kernels.inc"

namespace robostress {

const FusedKernels& Avx2FusedKernels() { return kTable; }

}  // namespace robostress
#endif
