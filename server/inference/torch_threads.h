#pragma once

namespace robostress {

// Limits LibTorch and OpenBLAS on the calling thread to one core: the server gains by running
// sessions beside each other, and a result must not depend on how many cores a reduction was split
// over. Cheap; every thread that computes calls it first.
void UseOneTorchThread();

}  // namespace robostress
