#pragma once

#include <Eigen/Core>
#include <memory>

#include "adapter/corrector.h"
#include "adapter/method_way.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"

namespace robostress {

// The paper's ablation without learning.
struct DirectOptions {
  using Corrector = class DirectSubtraction;
  static constexpr MethodWay kWay{.name = "direct_correction", .key = "direct", .alone = true};

  bool direct = false;

  bool on() const { return direct; }
  bool carries_over() const { return false; }
  absl::Status Check() const { return absl::OkStatus(); }

  template <class V>
  void Visit(V& v) {
    v.Field("direct", direct, "subtract the previous chunk's mean residual from the next chunk");
  }
};

// c = a - mean(eta) over the unmasked steps of the episode's last chunk that has some. The residual
// is against the policy's own command, so it sees its own correction, and the controller's lag.
class DirectSubtraction : public Corrector {
 public:
  DirectSubtraction(const DirectOptions&, const ResidualOptions& residual, const NominalArmOptions&)
      : residual_(residual) {}

  std::unique_ptr<Corrector> Clone() const override {
    return std::make_unique<DirectSubtraction>(*this);
  }
  void StartEpisode() override { mean_.resize(0); }
  void Observe(const ExecutedChunk& chunk) override;
  Eigen::VectorXd correction() const override { return -mean_; }

  Eigen::VectorXd State() const override { return mean_; }
  bool Holds(const Eigen::VectorXd& state) const override {
    return (state.array().abs() <= kMaxResidual).all();
  }
  void SetState(const Eigen::VectorXd& state) override { mean_ = state; }

 private:
  static constexpr double kMaxResidual = 1e12;  // plausible motion stays below
  ResidualOptions residual_;
  Eigen::VectorXd mean_;  // [action_dim], or empty: no chunk yet in this episode
};

}  // namespace robostress
