#include "common/rollout/replay_policy.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int kActionDim = 7;

class ReplayPolicy : public PolicyEndpoint {
 public:
  ReplayPolicy(Eigen::MatrixXf actions, std::string hash) : actions_(std::move(actions)) {
    spec_.name = "replay";
    spec_.model_hash = std::move(hash);
    spec_.state_dim = 0;
    spec_.action_dim = kActionDim;
    spec_.horizon = spec_.execute_steps;
  }

  const PolicySpec& spec() const override { return spec_; }
  absl::Status StartEpisode(const EpisodeKey&) override { return absl::OkStatus(); }

  absl::StatusOr<PredictedChunk> Predict(const Observation&, int chunk) override {
    PredictedChunk prediction;
    prediction.prediction_id = ++predictions_;
    prediction.actions.resize(spec_.horizon, kActionDim);
    for (int i = 0; i < spec_.horizon; ++i) {
      const int64_t row = int64_t{chunk} * spec_.execute_steps + i;
      if (row < actions_.rows()) {
        prediction.actions.row(i) = actions_.row(row);
      } else {
        prediction.actions.row(i).setZero();
        prediction.actions(i, kActionDim - 1) = actions_(actions_.rows() - 1, kActionDim - 1);
      }
    }
    prediction.policy_actions = prediction.actions;
    return prediction;
  }

  absl::Status SendFeedback(ExecutedChunk executed) override {
    stats_.feedback_chunks = executed.sequence;
    return absl::OkStatus();
  }
  absl::StatusOr<SessionStats> Stats() override { return stats_; }

 private:
  const Eigen::MatrixXf actions_;  // [T, 7]
  PolicySpec spec_;
  SessionStats stats_;
  uint64_t predictions_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeReplayPolicy(const std::string& file) {
  if (file.empty()) {
    return absl::InvalidArgumentError(
        "policy replay needs replay_file: a safetensors file with the tensor actions [T, 7]");
  }
  RS_ASSIGN_OR_RETURN(std::string bytes, ReadFile(file));
  const std::string hash = Sha256Hex(bytes);
  RS_ASSIGN_OR_RETURN(const SafetensorsFile tensors,
                      SafetensorsFile::Parse(file, std::move(bytes)));
  RS_ASSIGN_OR_RETURN(const std::vector<float> values,
                      tensors.ReadFloats("actions", {-1, kActionDim}));
  if (values.empty())
    return absl::InvalidArgumentError(absl::StrCat(file, ": tensor actions has no rows"));
  const auto bad =
      std::find_if(values.begin(), values.end(), [](float v) { return !std::isfinite(v); });
  if (bad != values.end()) {
    const auto index = bad - values.begin();
    return absl::InvalidArgumentError(absl::StrCat(file, ": actions[", index / kActionDim, ",",
                                                   index % kActionDim, "] is ", *bad,
                                                   ", must be finite"));
  }
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, kActionDim, Eigen::RowMajor>;
  const Eigen::MatrixXf actions = Eigen::Map<const RowMajor>(
      values.data(), static_cast<Eigen::Index>(values.size()) / kActionDim, kActionDim);
  return std::make_unique<ReplayPolicy>(actions, hash);
}

}  // namespace robostress
