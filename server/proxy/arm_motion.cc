#include "server/proxy/arm_motion.h"

#include <cmath>
#include <string_view>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/check.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "common/wire/openpi_readers.h"

namespace robostress {
namespace {

constexpr double kExpectedShare = 1.5;     // of what it was to move, that an arm may be off by
constexpr double kQuaternionError = 0.01;  // of its length

// Under the key itself, or in maps within maps.
const OpenpiValue* FindKey(const OpenpiValue& message, const std::string& key) {
  if (const OpenpiValue* found = message.Find(key)) return found;
  const OpenpiValue* at = &message;
  for (const auto part : absl::StrSplit(key, '/')) {
    at = at->Find(std::string_view(part.data(), part.size()));
    if (at == nullptr) return nullptr;
  }
  return at;
}

absl::StatusOr<std::vector<double>> StateNumbers(const OpenpiValue& observation,
                                                 const OpenpiDialect& keys) {
  std::vector<double> numbers;
  for (const std::string& key : keys.state) {
    const OpenpiValue* found = FindKey(observation, key);
    if (found == nullptr) return Invalid("the observation has no '", key, "'");
    RS_ASSIGN_OR_RETURN(const std::vector<double> part,
                        OpenpiNumbers(key, *found, WireLimits::kStateDim));
    numbers.insert(numbers.end(), part.begin(), part.end());
  }
  return numbers;
}

absl::StatusOr<Eigen::VectorXd> Picked(const std::vector<double>& numbers,
                                       const std::vector<int>& indices, const char* what) {
  Eigen::VectorXd picked(static_cast<Eigen::Index>(indices.size()));
  for (size_t i = 0; i < indices.size(); ++i) {
    const auto index = static_cast<size_t>(indices[i]);
    if (index >= numbers.size()) {
      return Invalid("the state has ", numbers.size(), " numbers; state.", what, " names index ",
                     index);
    }
    picked[static_cast<Eigen::Index>(i)] = numbers[index];
  }
  return picked;
}

absl::StatusOr<Eigen::Quaterniond> RotationOf(const Eigen::VectorXd& numbers,
                                              const std::string& form) {
  if (numbers.size() == 0) return Eigen::Quaterniond::Identity();
  if (form == "axis_angle") return ExpSo3(numbers);
  const double norm = numbers.norm();
  if (!(std::abs(norm - 1) <= kQuaternionError))
    return Invalid("the state's quaternion has length ", norm, ", must have 1");
  const Eigen::VectorXd unit = numbers / norm;
  return form == "quaternion_wxyz" ? Eigen::Quaterniond(unit[0], unit[1], unit[2], unit[3])
                                   : Eigen::Quaterniond(unit[3], unit[0], unit[1], unit[2]);
}

// As a method takes a command: its numbers, zeros for what the arm does not take, no gripper.
Eigen::VectorXf Command(const Eigen::VectorXd& numbers, bool joints) {
  Eigen::VectorXf command = Eigen::VectorXf::Zero(joints ? numbers.size() + 1 : 7);
  command.head(numbers.size()) = numbers.cast<float>();
  return command;
}

}  // namespace

absl::StatusOr<RobotState> ReadArmState(const OpenpiValue& observation, const ArmProfile& profile) {
  RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, StateNumbers(observation, profile.keys));
  RobotState state;
  if (profile.joint_space()) {
    RS_ASSIGN_OR_RETURN(state.q, Picked(numbers, profile.state.joints, "joints"));
    return state;
  }
  RS_ASSIGN_OR_RETURN(state.tool.p_base_tool, Picked(numbers, profile.state.position, "position"));
  RS_ASSIGN_OR_RETURN(const Eigen::VectorXd rotation,
                      Picked(numbers, profile.state.rotation, "rotation"));
  RS_ASSIGN_OR_RETURN(state.tool.q_base_tool, RotationOf(rotation, profile.state.rotation_form));
  return state;
}

double ArmMotionReader::meters() const {
  const ActionLayout& action = profile_.action;
  return action.translation_full > 0 ? action.translation_full : action.translation_unit;
}
double ArmMotionReader::radians() const {
  const ActionLayout& action = profile_.action;
  return action.rotation_full > 0 ? action.rotation_full : action.rotation_unit;
}

ExecutedChunk ArmMotionReader::Commands(const Eigen::MatrixXd& own,
                                        const Eigen::MatrixXd& sent) const {
  RS_CHECK(own.rows() > 0 && own.rows() == sent.rows() && own.cols() == sent.cols());
  ExecutedChunk chunk;
  for (Eigen::Index i = 0; i < own.rows(); ++i) {
    ExecutedStep step;
    step.policy_command = Command(own.row(i), profile_.joint_space());
    step.sent_command = Command(sent.row(i), profile_.joint_space());
    chunk.steps.push_back(std::move(step));
  }
  return chunk;
}

Eigen::MatrixXd ArmMotionReader::Nominal(const ExecutedChunk& chunk) {
  Eigen::MatrixXd nominal(chunk.steps.size(), 6);
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    nominal.row(static_cast<Eigen::Index>(i)) =
        arm_.Step(chunk.steps[i].sent_command.head<6>().cast<double>());
  }
  return nominal;
}

Eigen::VectorXd ArmMotionReader::Displacement(const RobotState& before,
                                              const RobotState& after) const {
  Eigen::VectorXd moved(6);
  moved.head<3>() = (after.tool.p_base_tool - before.tool.p_base_tool) / meters();
  moved.tail<3>() = RotationBetween(before.tool.q_base_tool, after.tool.q_base_tool) / radians();
  return moved;
}

void ArmMotionReader::Compare(const RobotState& before, const RobotState& after,
                              const Eigen::VectorXd& expected, ArmMotion& motion) const {
  Eigen::VectorXd surprise = Displacement(before, after) - expected;
  if (profile_.state.rotation.empty()) surprise.tail<3>().setZero();
  const double off_m = meters() * surprise.head<3>().norm(),
               off_rad = radians() * surprise.tail<3>().norm();
  // Written so that what is not a number is a jump.
  motion.jump =
      !(off_m <= kExpectedShare * meters() * expected.head<3>().norm() + profile_.limits.jump_m) ||
      !(off_rad <=
        kExpectedShare * radians() * expected.tail<3>().norm() + profile_.limits.jump_rad);
  motion.surprise = surprise.head(static_cast<Eigen::Index>(profile_.columns().size()));
}

void ArmMotionReader::CompareJoints(const RobotState& before, const RobotState& after,
                                    ArmMotion& motion) const {
  const Eigen::VectorXd target =
      motion.chunk.steps.back().sent_command.head(after.q.size()).cast<double>();
  motion.surprise = after.q - target;
  const double to_move = (target - before.q).cwiseAbs().maxCoeff();
  motion.jump = !(motion.surprise.cwiseAbs().maxCoeff() <=
                  kExpectedShare * to_move + profile_.limits.jump_rad);
}

ArmMotion ArmMotionReader::Between(const RobotState& before, const RobotState& after,
                                   const Eigen::MatrixXd& own, const Eigen::MatrixXd& sent) {
  ArmMotion motion;
  motion.chunk = Commands(own, sent);
  std::vector<ExecutedStep>& steps = motion.chunk.steps;
  motion.chunk.final_state = after;
  if (profile_.joint_space()) {
    for (size_t i = 0; i < steps.size(); ++i) {
      steps[i].before.q =
          i == 0 ? before.q
                 : Eigen::VectorXd(steps[i - 1].sent_command.head(before.q.size()).cast<double>());
    }
    motion.chunk.masked.assign(steps.size(), true);
    motion.chunk.masked.back() = false;
    CompareJoints(before, after, motion);
    return motion;
  }
  const Eigen::MatrixXd nominal = Nominal(motion.chunk);
  const Eigen::VectorXd expected = nominal.colwise().sum().transpose();
  Compare(before, after, expected, motion);
  Eigen::VectorXd rest = Displacement(before, after) - expected;
  if (profile_.state.rotation.empty()) rest.tail<3>().setZero();
  rest /= static_cast<double>(steps.size());
  RobotState state = before;
  for (size_t i = 0; i < steps.size(); ++i) {
    steps[i].before = state;
    const Eigen::VectorXd moved = nominal.row(static_cast<Eigen::Index>(i)).transpose() + rest;
    state.tool.p_base_tool += meters() * moved.head<3>();
    state.tool.q_base_tool =
        (ExpSo3(radians() * moved.tail<3>()) * state.tool.q_base_tool).normalized();
  }
  if (profile_.state.rotation.empty())
    motion.chunk.final_state.tool.q_base_tool = state.tool.q_base_tool;
  return motion;
}

ArmMotion ArmMotionReader::Measured(const std::vector<RobotState>& states,
                                    const Eigen::MatrixXd& own, const Eigen::MatrixXd& sent) {
  RS_CHECK(static_cast<Eigen::Index>(states.size()) == own.rows() + 1);
  ArmMotion motion;
  motion.chunk = Commands(own, sent);
  for (size_t i = 0; i < motion.chunk.steps.size(); ++i) motion.chunk.steps[i].before = states[i];
  motion.chunk.final_state = states.back();
  if (profile_.joint_space()) {
    CompareJoints(states.front(), states.back(), motion);
  } else {
    Compare(states.front(), states.back(), Nominal(motion.chunk).colwise().sum().transpose(),
            motion);
  }
  return motion;
}

}  // namespace robostress
