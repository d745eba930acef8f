#pragma once

#include <Eigen/Core>
#include <optional>

#include "adapter/integral_action.h"
#include "adapter/model_following.h"

namespace robostress {

// What a method adds to a policy's commands and leaves the policy as it is: the sum of `direct`
// (paper, the ablation without learning), integral action and model following, as far as the method
// has them.
class CommandCorrection {
 public:
  // What it remembers; a part is empty where the method does not have it, or has no value yet.
  struct State {
    Eigen::VectorXd direct, integral, following;
  };

  CommandCorrection(const MethodOptions& method, const ResidualOptions& residual,
                    const NominalArmOptions& arm);

  void StartEpisode();
  // `residual`: ChunkResidual of the chunk with these options. A chunk after which the state would
  // not hold leaves it as it was.
  void Observe(const ExecutedChunk& chunk, const Eigen::MatrixXd& residual);
  // [n] added to the first n entries of every command; empty: nothing.
  Eigen::VectorXd Value() const;

  State state() const;
  // False, and nothing changes, where the state is not of such a method or does not hold.
  bool set_state(const State& state);

 private:
  static constexpr double kMaxDirect = 1e12;  // a mean residual; plausible motion stays below
  // Whether Observe can have left it: parts as the method has them, bounded numbers.
  bool Holds(const State& state) const;

  bool has_direct_;
  Eigen::VectorXd direct_;  // mean residual [action_dim] or empty: no chunk yet in this episode
  std::optional<IntegralAction> integral_;
  std::optional<ModelFollowing> following_;
};

}  // namespace robostress
