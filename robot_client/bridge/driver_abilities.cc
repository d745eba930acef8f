#include "robot_client/bridge/driver_abilities.h"

#include <algorithm>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"

namespace robostress::bridge {
namespace {

std::string LinkPairNames(const std::vector<LinkPair>& pairs) {
  return absl::StrJoin(
      pairs, ", ", [](std::string* out, const LinkPair& pair) { out->append(LinkPairName(pair)); });
}

std::string LeftOutNames(const std::vector<LeftOut>& links) {
  return absl::StrJoin(links, ", ", [](std::string* out, const LeftOut& link) {
    absl::StrAppend(out, link.all ? "all of J" : "a part of J", link.link + 1);
  });
}

std::string UnitName(AxisUnit unit) {
  switch (unit) {
    case AxisUnit::kRadians:
      return "radians";
    case AxisUnit::kDegrees:
      return "degrees";
    case AxisUnit::kMetres:
      return "metres";
    case AxisUnit::kRange:
      return "range";
  }
  return "?";
}

// What an axis's numbers are in the file and not for the driver; empty: they agree, or it does not
// say. Two numbers of a range may be any of the driver's.
std::string OtherUnit(const AxisOptions& axis, const SaidUnit& said) {
  const bool is_range = axis.unit == AxisUnit::kRange;
  if (said.range.empty() ? said.name.empty() || is_range || said.name == UnitName(axis.unit)
                         : is_range &&
                               *std::min_element(axis.driver_range.begin(),
                                                 axis.driver_range.end()) >= said.range[0] &&
                               *std::max_element(axis.driver_range.begin(),
                                                 axis.driver_range.end()) <= said.range[1])
    return "";
  const std::string file =
      is_range ? absl::StrCat("driver_range [", absl::StrJoin(axis.driver_range, ", "), "]")
               : UnitName(axis.unit);
  return said.range.empty()
             ? absl::StrCat("the driver counts ", axis.name, " in ", said.name,
                            ", the robot file in ", file, "; correct its unit")
             : absl::StrCat(
                   "the driver counts ", axis.name, " from ", said.range[0], " to ", said.range[1],
                   ", the robot file in ", file, "; say unit: range, driver_range: [",
                   said.range[0], ", ", said.range[1],
                   "] and range: what those are, or let the driver count in ", UnitName(axis.unit),
                   is_range ? "" : " (LeRobot: --robot.use_degrees=true)");
}

}  // namespace

std::string Unfit(const BridgeRobot& robot, const Welcome& w) {
  if (w.protocol != kVersion)
    return absl::StrCat("the driver speaks version ", w.protocol, ", this client ", int{kVersion},
                        "; take the driver that came with this client");
  if (w.axes != robot.names())
    return absl::StrCat("the driver drives [", absl::StrJoin(w.axes, ", "), "], the robot file [",
                        absl::StrJoin(robot.names(), ", "), "]; correct the names in the file");
  for (size_t i = 0; i < w.units.size(); ++i) {
    const AxisOptions& axis = i < robot.joints.size() ? robot.joints[i] : *robot.gripper;
    if (std::string other = OtherUnit(axis, w.units[i]); !other.empty()) return other;
  }
  if (const std::string missing = Missing(robot.driver, w); !missing.empty())
    return absl::StrCat("the driver cannot do what the robot file expects: ", missing,
                        "; take another driver, or, knowing what is lost, say so under driver: "
                        "in the robot file");
  if (robot.simulated && !w.simulated)
    return "the robot file says simulated: true, the driver says that its arm is real; correct the "
           "file";
  return "";
}

std::string Differs(const Welcome& first, const Welcome& again) {
  const auto abilities = [](const Welcome& w) {
    return std::tuple(w.robot, w.stop, w.hold, w.torque_off, w.measures_velocity, w.measures_effort,
                      w.monotonic, w.simulated, w.on_silence, w.watchdog_s, w.units);
  };
  if (abilities(again) == abilities(first)) return "";
  return absl::StrCat(
      "another driver answers: it drives '", again.robot, "', the one before '", first.robot,
      "', or it can do other things; start the one before, or quit and start the client again");
}

std::vector<std::string> WhatADriverSays(const BridgeRobot& robot, const Welcome& w,
                                         double velocity_window_s) {
  std::vector<std::string> lines;
  std::vector<std::string> names;
  for (int i = 0; i < robot.limits.axes.joints; ++i)
    names.push_back(absl::StrCat("J", i + 1, " ", robot.joints[i].name));
  if (robot.gripper) names.push_back(absl::StrCat("gripper ", robot.gripper->name));
  lines.push_back(absl::StrCat("axes: ", absl::StrJoin(names, ", ")));
  const bool watched = w.on_silence != OnSilence::kNothing && w.watchdog_s > 0;
  lines.push_back(
      watched ? absl::StrCat("when this client is silent for ", w.watchdog_s,
                             " s, or ends, the driver says: ", OnSilenceName(w.on_silence))
              : "WARNING: when this client dies the driver does NOTHING: the arm goes to its last "
                "target");
  if (!w.hold)
    lines.emplace_back("WARNING: the driver does not say that the arm holds without new targets");
  if (!w.stop)
    lines.emplace_back(
        "WARNING: the driver has no stop: the second Ctrl-C holds where the arm stands");
  if (!w.torque_off)
    lines.emplace_back(
        "WARNING: the driver cannot take the power off: quit limp is refused, use the switch");
  if (!w.measures_effort || !robot.watches_torque())
    lines.emplace_back(
        "torques are not watched: an arm that presses is held when it is blocked, not before");
  if (!w.measures_velocity)
    lines.push_back(absl::StrFormat("no velocities: they are estimated over %.0f ms",
                                    1000 * velocity_window_s));
  if (!w.monotonic)
    lines.emplace_back(
        "WARNING: the driver does not stamp its samples: how old they are is not known");
  if (!robot.chain) {
    lines.emplace_back(
        "no model of this arm: table, box and the arm against itself are not watched");
  } else {
    const ArmChain& chain = *robot.chain;
    const bool torques = w.measures_effort && robot.watches_torque();
    lines.push_back(absl::StrCat("watched by ", chain.file, ": table, box",
                                 chain.watched.empty() ? "" : ", the arm against itself",
                                 torques ? ", torques" : ""));
    if (chain.meshes > 0) lines.push_back(absl::StrCat("shapes of ", chain.meshes, " meshes"));
    if (!chain.missing_meshes.empty())
      lines.push_back(absl::StrFormat(
          "WARNING: %d meshes are missing, %s first; a link without any is %g m about its bone: "
          "put "
          "them where the URDF says, or name the folder of package:// in model.packages",
          chain.missing_meshes.size(), chain.missing_meshes.front(), robot.model->radius));
    if (!chain.held.empty())
      lines.push_back(
          absl::StrCat("WARNING: not driven, and at 0 in the model, on the way to the "
                       "tool: ",
                       absl::StrJoin(chain.held, ", ")));
    if (!chain.below_table.empty())
      lines.push_back(absl::StrCat("not watched against the table, below it in nearly all poses: ",
                                   LeftOutNames(chain.below_table)));
    if (!chain.below_box.empty())
      lines.push_back(absl::StrCat("not watched against the box, below it in nearly all poses: ",
                                   LeftOutNames(chain.below_box)));
    if (chain.watched.empty()) {
      lines.emplace_back(
          "not watched: the arm against itself; its links have no shapes, or more than 256 parts");
    }
    if (!chain.watched.empty() && !chain.too_near.empty())
      lines.push_back(
          absl::StrCat("not watched against each other, near in most poses or at home: ",
                       LinkPairNames(chain.too_near)));
    if (!chain.partly_near.empty())
      lines.push_back(absl::StrCat("not watched against each other with the parts that are: ",
                                   LinkPairNames(chain.partly_near)));
    if (chain.touching > 0.1)
      lines.push_back(absl::StrFormat(
          "by their shapes its links touch in %.0f %% of all poses, %s most often; other shapes "
          "in the file or model.ignore help where the arm is held for nothing",
          100 * chain.touching, LinkPairName(chain.touching_most)));
    if (!chain.ignored.empty())
      lines.push_back(absl::StrCat("not watched against each other, as the robot file says: ",
                                   LinkPairNames(chain.ignored)));
  }
  if (!w.note.empty()) lines.push_back(absl::StrCat("the driver says: ", w.note));
  return lines;
}

}  // namespace robostress::bridge
