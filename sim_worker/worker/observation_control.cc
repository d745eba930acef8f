#include "sim_worker/worker/observation_control.h"

#include <algorithm>
#include <utility>

#include "adapter/method_options.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint8_t kMidGrey = 128;

class ControlledRobot : public Robot {
 public:
  ControlledRobot(std::shared_ptr<Robot> robot, ObservationInput input,
                  std::vector<std::string> instructions, int task)
      : robot_(std::move(robot)),
        input_(input),
        instructions_(std::move(instructions)),
        task_(task) {}

  absl::Status Reset(int initial_state) override {
    first_state_.resize(0);
    initial_state_ = initial_state;
    return robot_->Reset(initial_state);
  }

  absl::StatusOr<Observation> Observe(const PolicySpec& spec) override {
    RS_ASSIGN_OR_RETURN(Observation observation, robot_->Observe(spec));
    switch (input_) {
      case ObservationInput::kFull:
        break;
      case ObservationInput::kShuffledInstruction:
        observation.instruction = OtherInstruction(observation.instruction);
        break;
      case ObservationInput::kBlankImages:
        for (CameraView& view : observation.views)
          std::fill(view.image.data.begin(), view.image.data.end(), kMidGrey);
        break;
      case ObservationInput::kFrozenState:
        if (first_state_.size() == 0) first_state_ = observation.proprioception;
        observation.proprioception = first_state_;
        break;
    }
    return observation;
  }

  absl::StatusOr<RobotState> Measure() override { return robot_->Measure(); }
  absl::Status Step(const Eigen::VectorXf& command) override { return robot_->Step(command); }
  bool Success() const override { return robot_->Success(); }
  int horizon() const override { return robot_->horizon(); }

 private:
  std::string OtherInstruction(const std::string& own) const {
    const int n = static_cast<int>(instructions_.size());
    return n < 2 ? own : instructions_[(task_ + 1 + initial_state_ % (n - 1)) % n];
  }

  const std::shared_ptr<Robot> robot_;
  const ObservationInput input_;
  const std::vector<std::string> instructions_;
  const int task_;
  int initial_state_ = 0;
  Eigen::VectorXf first_state_;
};

}  // namespace

std::shared_ptr<Robot> ControlObservations(std::shared_ptr<Robot> robot, ObservationInput input,
                                           std::vector<std::string> instructions, int task) {
  if (input == ObservationInput::kFull) return robot;
  return std::make_shared<ControlledRobot>(std::move(robot), input, std::move(instructions), task);
}

}  // namespace robostress
