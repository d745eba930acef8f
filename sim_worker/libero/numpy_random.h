#pragma once

#include <cstdint>
#include <random>

namespace robostress::libero {

// NumPy's global generator as np.random.seed(seed) leaves it: Mersenne Twister MT19937 seeded by
// init_genrand (which std::mt19937 is), doubles of 53 bits, and the legacy distributions that NumPy
// keeps frozen (NEP 19; numpy/random/src/legacy/legacy-distributions.c, mt19937.h). Draws equal
// NumPy's to the bit; Randn as far as the C library's log does.
class NumpyRandom {
 public:
  explicit NumpyRandom(uint32_t seed) : engine_(seed) {}

  // random_sample(): [0, 1), two words of the engine.
  double Random();
  // uniform(low, high): low + (high - low) * Random(); low may exceed high, as in NumPy.
  double Uniform(double low, double high);
  // randn(): the polar method's pairs; every second call returns the value kept by the first.
  double Randn();
  // randint(n), 0 .. n-1 for n >= 1: words masked to n - 1's bits until one fits; n == 1 draws
  // nothing.
  int Randint(int n);

 private:
  std::mt19937 engine_;
  bool has_gauss_ = false;
  double gauss_ = 0;
};

}  // namespace robostress::libero
