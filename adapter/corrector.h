#pragma once

#include <Eigen/Core>
#include <memory>

#include "common/types.h"

namespace robostress {

// A way of compensating that adds to a policy's commands and leaves the policy as it is. One robot;
// for one thread at a time. It learns from executed chunks in the order of their execution.
class Corrector {
 public:
  virtual ~Corrector() = default;
  virtual std::unique_ptr<Corrector> Clone() const = 0;

  virtual void StartEpisode() = 0;
  virtual void Observe(const ExecutedChunk& chunk) = 0;
  // Keeps this share of what it would correct: something holds the arm (envelope.h).
  virtual void Forget(double /*kept*/) {}
  // What it learned stays for more than the steps that a held arm is told by.
  virtual bool LearnsSlowly() const { return false; }
  // [n] added to the first n entries of every command of the next chunk [command units]; empty:
  // nothing yet.
  virtual Eigen::VectorXd correction() const = 0;

  // All that it remembers.
  virtual Eigen::VectorXd State() const = 0;
  // Whether Observe can have left it.
  virtual bool Holds(const Eigen::VectorXd& state) const = 0;
  // Of a state that it holds.
  virtual void SetState(const Eigen::VectorXd& state) = 0;
};

}  // namespace robostress
