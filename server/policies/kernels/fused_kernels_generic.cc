#include "server/policies/kernels/fused_kernels.inc"

namespace robostress {

const FusedKernels& GenericFusedKernels() { return kTable; }

const FusedKernels& BestFusedKernels() {
#if defined(__x86_64__)
  static const FusedKernels& best =
      __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? Avx2FusedKernels() : kTable;
  return best;
#else
  return kTable;
#endif
}

}  // namespace robostress
