#include "robot_client/robot_arm.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {
namespace {

struct NamedFault {
  ArmFault bit;
  const char* name;
};
constexpr NamedFault kNames[] = {
    {kFaultEmergencyStop, "emergency stop"},
    {kFaultNoSolution, "no inverse kinematic solution"},
    {kFaultTargetLimit, "target beyond a limit"},
    {kFaultJointLimit, "joint beyond its limit"},
    {kFaultJointBus, "a joint does not answer"},
    {kFaultBrake, "brake"},
    {kFaultCollision, "collision"},
    {kFaultStall, "stalled motor"},
    {kFaultOverCurrent, "over-current"},
    {kFaultOverTemperature, "over-temperature"},
    {kFaultUnderVoltage, "under-voltage"},
    {kFaultDriver, "driver or sensor error"},
    {kFaultGripper, "gripper driver"},
    {kFaultOther, "abnormal status"},
    {kFaultForeignCommand, "another sender commands this arm"},
    {kFaultBus, "bus error"},
    {kFaultStatus, "the arm's status is missing or unknown"},
    {kFaultMode, "the arm left the mode in which it takes commands"},
    {kFaultNotStopped, "it was told to stop and does not: use the switch"},
};

}  // namespace

std::string ArmAxes::name(int axis) const {
  return axis < joints ? absl::StrCat("J", axis + 1) : "gripper";
}

std::vector<std::string> ArmAxes::names() const {
  std::vector<std::string> names;
  for (int axis = 0; axis < count(); ++axis) names.push_back(name(axis));
  return names;
}

std::string ArmAxes::text() const {
  return absl::StrCat(joints, " joint", joints == 1 ? "" : "s", gripper ? " and a gripper" : "");
}

std::string ArmFaultNames(uint32_t faults, uint8_t joints) {
  if (faults == 0) return "none";
  std::vector<std::string> names;
  for (const NamedFault& fault : kNames) {
    if (faults & fault.bit) names.emplace_back(fault.name);
  }
  std::vector<std::string> which;
  for (int j = 0; j < kMostJoints; ++j) {
    if (joints & (1 << j)) which.push_back(absl::StrCat("J", j + 1));
  }
  return absl::StrCat(absl::StrJoin(names, ", "),
                      which.empty() ? "" : absl::StrCat(" (", absl::StrJoin(which, ", "), ")"));
}

}  // namespace robostress
