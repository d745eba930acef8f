#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "adapter/corrector.h"
#include "adapter/envelope.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"

namespace robostress {

struct MethodOptions;  // adapter/method_options.h

// What a method adds to a policy's commands and leaves the policy as it is: the sum of its
// correctors. Copies are independent of each other.
class CommandCorrection {
 public:
  // What it remembers, by the name of the way; nothing where a way has no value yet.
  using State = std::map<std::string, Eigen::VectorXd>;

  CommandCorrection(const MethodOptions& method, const ResidualOptions& residual,
                    const NominalArmOptions& arm);
  CommandCorrection(const CommandCorrection& other);
  CommandCorrection(CommandCorrection&&) = default;
  CommandCorrection& operator=(CommandCorrection other);

  void StartEpisode();
  // A chunk after which the state would not hold leaves it as it was.
  void Observe(const ExecutedChunk& chunk);
  // [n] added to the first n entries of every command; empty: nothing.
  Eigen::VectorXd Value() const;

  State state() const;
  // False, and nothing changes, where the state is not of such a method or does not hold.
  bool set_state(const State& state);

 private:
  struct Part {
    std::string name;  // of the way
    std::unique_ptr<Corrector> corrector;
  };
  // Whether Observe can have left it.
  bool Holds(const State& state) const;

  void FindEnvelope();
  void ObserveWithin(Envelope& envelope, ExecutedChunk step);

  std::vector<Part> parts_;
  Envelope* envelope_ = nullptr;  // one of parts_, if the method has it
};

// Of a session.
NominalArmOptions NominalArmOf(const SessionSetting& setting, const MethodOptions& method);
ResidualOptions ResidualOf(const SessionSetting& setting, const MethodOptions& method);

// The chunk that is sent: the policy's with the method's gain, `correction` (of the arm's entries;
// empty: none) and the bounds of `policy` after both.
void CorrectCommands(const MethodOptions& method, const PolicySpec& policy,
                     const Eigen::VectorXd& correction, PredictedChunk& answer);

// Smooths a command [action_dim] after everything else: c <- s c_before + (1 - s) c on the arm's
// entries, s = smoothing, c_before the command issued before it (empty: zero, a new episode). The
// mean delay is s / (1 - s) control steps, the steady gain 1. As both commands are within a
// policy's bounds, so is the mean.
void SmoothCommand(double smoothing, const Eigen::VectorXf& before, Eigen::VectorXf& command);

}  // namespace robostress
