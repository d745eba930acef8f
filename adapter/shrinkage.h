#pragma once

namespace robostress {

// The share that is kept of a quantity of size `size` when what an undisturbed arm shows as well is
// taken out: 0 up to `threshold`, 1 - (threshold / size)^2 above it (the non-negative garrote,
// Breiman 1995, doi:10.1080/00401706.1995.10484371). Continuous, and large values keep their size.
inline double KeptShare(double size, double threshold) {
  if (size <= threshold) return threshold > 0 ? 0 : 1;
  return 1 - (threshold / size) * (threshold / size);
}

}  // namespace robostress
