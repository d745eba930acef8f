#include "sim_worker/libero/numpy_random.h"

#include <bit>
#include <cmath>

#include "common/check.h"

namespace robostress::libero {

double NumpyRandom::Random() {
  const uint32_t high = engine_() >> 5, low = engine_() >> 6;
  return (high * 67108864.0 + low) / 9007199254740992.0;  // (high 2^26 + low) / 2^53
}

double NumpyRandom::Uniform(double low, double high) {
  const double range = high - low;
  return low + range * Random();
}

double NumpyRandom::Randn() {
  if (has_gauss_) {
    has_gauss_ = false;
    return gauss_;
  }
  double x1, x2, r2;
  do {
    x1 = 2.0 * Random() - 1.0;
    x2 = 2.0 * Random() - 1.0;
    r2 = x1 * x1 + x2 * x2;
  } while (r2 >= 1.0 || r2 == 0.0);
  const double f = std::sqrt(-2.0 * std::log(r2) / r2);
  gauss_ = f * x1;
  has_gauss_ = true;
  return f * x2;
}

int NumpyRandom::Randint(int n) {
  RS_CHECK(n >= 1);
  const uint32_t largest = static_cast<uint32_t>(n) - 1;
  if (largest == 0) return 0;
  const uint32_t mask = std::bit_ceil(largest + 1) - 1;
  uint32_t value;
  do {
    value = static_cast<uint32_t>(engine_()) & mask;
  } while (value > largest);
  return static_cast<int>(value);
}

}  // namespace robostress::libero
