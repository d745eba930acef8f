#pragma once

#include <string>
#include <vector>

#include "robot_client/bridge/protocol.h"
#include "robot_client/bridge/robot_file.h"

// What a driver says of itself in its welcome, beside what the robot file expects.
namespace robostress::bridge {

// Why this driver cannot drive that robot, and what to do; empty: it can.
std::string Unfit(const BridgeRobot& robot, const Welcome& w);

// What differs from the driver that was there before; empty: nothing. A driver that can do less, or
// drives another arm, is no repair: a person was told what the first one can.
std::string Differs(const Welcome& first, const Welcome& again);

// What a person must know before the arm moves, a line each. velocity_window_s: over which
// velocities are estimated where the driver measures none.
std::vector<std::string> WhatADriverSays(const BridgeRobot& robot, const Welcome& w,
                                         double velocity_window_s);

}  // namespace robostress::bridge
