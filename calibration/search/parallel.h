#pragma once

#include <algorithm>
#include <atomic>
#include <thread>
#include <vector>

namespace robostress::calibration {

// f(0) ... f(n - 1) on all cores. The order of calls is open, so f must not depend on it.
template <class F>
void ParallelFor(int n, const F& f) {
  const int threads =
      std::min(n, std::max(1, static_cast<int>(std::thread::hardware_concurrency())));
  std::atomic<int> next = 0;
  const auto work = [&] {
    for (int i = next++; i < n; i = next++) f(i);
  };
  std::vector<std::jthread> others;
  for (int i = 1; i < threads; ++i) others.emplace_back(work);
  work();
}

}  // namespace robostress::calibration
