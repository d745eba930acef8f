#include "robot_client/robot_arm.h"

#include <vector>

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
};

}  // namespace

std::string ArmFaultNames(uint32_t faults) {
  if (faults == 0) return "none";
  std::vector<std::string> names;
  for (const NamedFault& fault : kNames) {
    if (faults & fault.bit) names.emplace_back(fault.name);
  }
  return absl::StrJoin(names, ", ");
}

}  // namespace robostress
