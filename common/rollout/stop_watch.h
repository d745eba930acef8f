#pragma once

#include <chrono>

namespace robostress {

// Adds the wall time of a scope to a total [s].
class StopWatch {
 public:
  explicit StopWatch(double& total) : total_(total), start_(std::chrono::steady_clock::now()) {}
  ~StopWatch() {
    total_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  double& total_;
  std::chrono::steady_clock::time_point start_;
};

}  // namespace robostress
