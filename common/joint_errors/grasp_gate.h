#pragma once

#include <algorithm>

namespace robostress {

// Gate of Heavy Payload (paper, sec:supp_composite): opens when an object is held, linearly over
// kRampIn, and closes at once when the object has been let go for kReleaseSteps control steps. A
// grasp regained before that leaves it as it is, so a flickering contact does not fire the ramp
// again.
class GraspGate {
 public:
  static constexpr double kRampIn = 0.1;   // [s]
  static constexpr int kReleaseSteps = 3;  // control steps

  void Reset() { *this = GraspGate(); }
  // At the start of a control step, with what the grasp check says there.
  void BeginControlStep(bool held) {
    if (held) {
      closed_ = true;
      steps_since_held_ = 0;
    } else if (closed_ && ++steps_since_held_ > kReleaseSteps) {
      Reset();
    }
  }
  // One physics sub-step of h [s]; returns the gate in [0, 1].
  double SubStep(double h) {
    if (closed_) elapsed_ = std::min(elapsed_ + h, kRampIn);
    return value();
  }
  double value() const { return elapsed_ >= kRampIn - 1e-9 ? 1.0 : elapsed_ / kRampIn; }
  bool closed() const { return closed_; }

 private:
  bool closed_ = false;  // the payload is on
  int steps_since_held_ = 0;
  double elapsed_ = 0;  // [s] since it closed, at most kRampIn
};

}  // namespace robostress
