#pragma once

#include <cstdint>

namespace robostress {

// Calls `function` on this thread before each LibTorch operator that it runs, those of a backward
// pass included, until destruction. One per thread at a time. An update of nano has some 1,400: it
// can stop within a fraction of a millisecond.
class OperatorHook {
 public:
  explicit OperatorHook(void (*function)());
  ~OperatorHook();
  OperatorHook(const OperatorHook&) = delete;
  OperatorHook& operator=(const OperatorHook&) = delete;

 private:
  const uint64_t handle_;
};

}  // namespace robostress
