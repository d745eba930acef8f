#pragma once

#include <cstring>
#include <string>
#include <vector>

#include "server/proxy/arm_profile.h"
#include "tests/common/wire/openpi_bytes.h"

namespace robostress {

// openpi's LIBERO client and server, byte by byte.
inline std::string LiberoObservation(const std::vector<double>& state,
                                     const std::string& prompt = "do something",
                                     const std::string& pixels = "abc") {
  OpenpiBytes bytes;
  bytes.Map(3)
      .Text("observation/image")
      .Array("|u1", {1, 1, 3}, pixels)
      .Text("observation/state")
      .Numbers<double>("<f8", {static_cast<int>(state.size())}, state);
  return bytes.Text("prompt").Text(prompt).bytes();
}

// actions as <f4 or <f8.
template <class T = float>
std::string ActionRows(const Eigen::MatrixXd& actions) {
  std::vector<T> numbers;
  for (Eigen::Index i = 0; i < actions.rows(); ++i)
    for (Eigen::Index j = 0; j < actions.cols(); ++j)
      numbers.push_back(static_cast<T>(actions(i, j)));
  OpenpiBytes bytes;
  bytes.Map(2)
      .Text("actions")
      .Numbers<T>(sizeof(T) == 4 ? "<f4" : "<f8",
                  {static_cast<int>(actions.rows()), static_cast<int>(actions.cols())}, numbers)
      .Text("policy_timing")
      .Map(1)
      .Text("infer_ms")
      .Integer(3);
  return bytes.bytes();
}

// actions[i] = action, `rows` times.
template <class T = float>
std::string ActionAnswer(const std::vector<double>& action, int rows = 10) {
  const auto cols = static_cast<Eigen::Index>(action.size());
  return ActionRows<T>(
      Eigen::Map<const Eigen::RowVectorXd>(action.data(), cols).replicate(rows, 1));
}

inline ArmProfile LiberoProfile(bool real_time = false) {
  ArmProfile profile;
  profile.name = "panda";
  profile.control_space = "end_effector";
  profile.real_time = real_time;
  profile.execute_steps = 5;
  profile.state.position = {0, 1, 2};
  profile.state.rotation = {3, 4, 5};
  profile.action.translation = {0, 1, 2};
  profile.action.rotation = {3, 4, 5};
  profile.keys = {.name = "libero", .state = {"observation/state"}};
  return profile;
}

// Joints 0..n-1 of n + 1 numbers, the last a gripper's; observation {state, prompt}.
inline ArmProfile JointProfile(int joints, bool real_time = false) {
  ArmProfile profile;
  profile.name = "arm";
  profile.control_space = "joint";
  profile.real_time = real_time;
  profile.execute_steps = 5;
  profile.method = "dob";
  profile.action.size = joints + 1;
  for (int i = 0; i < joints; ++i) {
    profile.state.joints.push_back(i);
    profile.action.joints.push_back(i);
  }
  profile.keys = {.name = "aloha", .state = {"state"}};
  return profile;
}

inline std::string JointObservation(const std::vector<double>& state) {
  OpenpiBytes bytes;
  bytes.Map(2).Text("state").Numbers<double>("<f8", {static_cast<int>(state.size())}, state);
  return bytes.Text("prompt").Text("do something").bytes();
}

}  // namespace robostress
