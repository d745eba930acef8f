#pragma once

namespace robostress::openpi {

// Threads of matrix products and loops. LibTorch's own count holds for the calling thread alone, so
// each thread that predicts calls this; OpenBLAS, where it is the BLAS and counts its threads
// itself, takes the count for the whole process (at::set_num_threads does not reach it).
// OPENBLAS_NUM_THREADS bounds it from the start of the process. n >= 1.
void SetComputeThreads(int n);

// What OpenBLAS uses, 0 where another BLAS is linked.
int BlasThreads();

}  // namespace robostress::openpi
