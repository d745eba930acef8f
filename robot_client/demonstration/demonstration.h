#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/lerobot/lerobot_dataset.h"
#include "common/types.h"
#include "robot_client/robot_arm.h"

namespace robostress {

// One control tick of a demonstration.
struct DemonstrationTick {
  int64_t stamp_ns = 0;  // the client's clock
  ArmVector state{};     // measured joints [rad] and opening [m], before the action
  ArmVector action{};    // what was asked for as absolute targets, before limits
};

// A whole episode as the formats want it: pictures[camera][tick].
struct DemonstrationEpisode {
  std::string instruction;
  bool success = false;
  ArmAxes axes;  // of the ticks
  double rate_hz = 30;
  std::vector<std::string> cameras;
  std::vector<DemonstrationTick> ticks;
  std::vector<std::vector<std::string>> jpegs;  // whole pictures
  std::vector<std::vector<Image>> small;        // squares of one size, for LIBERO and training
  std::vector<int> width, height;               // of the whole pictures [px], per camera
};

// As LeRobot's form has it: observation.state and action, joints [rad] and opening [m].
LerobotSchema LerobotSchemaOf(const std::string& robot, const ArmAxes& axes, double rate_hz,
                              const std::vector<std::string>& cameras);
LerobotEpisode ToLerobot(const DemonstrationEpisode& episode);

}  // namespace robostress
