#pragma once

#include <ctime>
#include <vector>

#include "common/statistics.h"

namespace robostress {

// CPU time of the calling thread [s]: what other processes do on the machine does not count.
inline double CpuSeconds() {
  timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// CPU time of one call [s].
template <class F>
double TimeOf(const F& call) {
  const double start = CpuSeconds();
  call();
  return CpuSeconds() - start;
}

// Median over batches of the mean CPU time of a call that is shorter than the clock can see [s].
template <class F>
double TimeOfShort(const F& call) {
  constexpr int kBatches = 11, kCalls = 2000;
  std::vector<double> batches;
  for (int i = 0; i < kBatches; ++i) {
    batches.push_back(TimeOf([&] {
                        for (int k = 0; k < kCalls; ++k) call();
                      }) /
                      kCalls);
  }
  return UpperMedian(std::move(batches));
}

}  // namespace robostress
