#include "adapter/command_correction.h"

#include "absl/algorithm/container.h"

namespace robostress {
namespace {

// Mean of the unmasked rows [action_dim]; none: nothing. Masked rows are 0.
std::optional<Eigen::VectorXd> MeanResidual(const ExecutedChunk& executed,
                                            const Eigen::MatrixXd& residual) {
  const auto masked = absl::c_count(executed.masked, true);
  if (masked == static_cast<int64_t>(executed.steps.size())) return std::nullopt;
  if (masked == 0) return residual.colwise().mean().transpose();
  return residual.colwise().sum().transpose() / static_cast<double>(residual.rows() - masked);
}

}  // namespace

CommandCorrection::CommandCorrection(const MethodOptions& method, const ResidualOptions& residual,
                                     const NominalArmOptions& arm)
    : has_direct_(method.direct) {
  if (method.integral_rate > 0) integral_.emplace(method, residual, arm);
  if (method.following_gain > 0) following_.emplace(method, residual, arm);
}

void CommandCorrection::StartEpisode() {
  direct_.resize(0);
  if (integral_) integral_->StartEpisode();
  if (following_) following_->StartEpisode();
}

void CommandCorrection::Observe(const ExecutedChunk& chunk, const Eigen::MatrixXd& residual) {
  const State before = state();
  if (has_direct_) direct_ = MeanResidual(chunk, residual).value_or(direct_);
  if (integral_) integral_->Observe(chunk);
  if (following_) following_->Observe(chunk);
  if (!Holds(state())) set_state(before);
}

Eigen::VectorXd CommandCorrection::Value() const {
  if (!integral_ && !following_) return -direct_;
  Eigen::VectorXd value = Eigen::VectorXd::Zero(6);
  if (integral_) value += integral_->correction();
  if (following_) value += following_->correction();
  return value;
}

CommandCorrection::State CommandCorrection::state() const {
  State state;
  state.direct = direct_;
  if (integral_) state.integral = integral_->State();
  if (following_) state.following = following_->State();
  return state;
}

bool CommandCorrection::Holds(const State& state) const {
  if (!has_direct_ && state.direct.size() > 0) return false;
  if (!(state.direct.array().abs() <= kMaxDirect).all()) return false;
  if (integral_ ? !integral_->Holds(state.integral) : state.integral.size() > 0) return false;
  return following_ ? following_->Holds(state.following) : state.following.size() == 0;
}

bool CommandCorrection::set_state(const State& state) {
  if (!Holds(state)) return false;
  direct_ = state.direct;
  if (integral_) integral_->SetState(state.integral);
  if (following_) following_->SetState(state.following);
  return true;
}

}  // namespace robostress
