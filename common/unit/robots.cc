#include "common/unit/robots.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/embedded_policies.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {
namespace {

// Everything that needs no disturbance observer, which is robot_client's.
std::vector<std::string> WithoutObserver() {
  std::vector<std::string> names;
  for (const std::string& name : MethodNames()) {
    const absl::StatusOr<MethodOptions> method = MakeMethod(name);
    if (method.ok() && !method->observer) names.push_back(name);
  }
  return names;
}

}  // namespace

const std::vector<RobotInfo>& AllRobots() {
  static const auto& robots = *new std::vector<RobotInfo>{
      {.name = "panda",
       .description = kPanda,
       .worker = "worker",
       .policy = "nano",
       .suites = {"tabletop_goal"},
       .arms = {},
       .methods = WithoutObserver(),
       .policies = {kSuitePolicies.begin(), kSuitePolicies.end()}},
      {.name = "piper",
       .description = kPiper,
       .worker = "piper-worker",
       .policy = kPiperPolicy,
       .suites = {"piper_1_next_to_plate", "piper_2_on_cabinet", "piper_3_on_box",
                  "piper_4_open_drawer"},
       .arms = {{"new", "Robot A, new"}, {"used_one_year", "Robot B, used for a year"}},
       // A server corrects joint targets by what it learned only
       // (server/sessions/session_checks.cc); the rest is done by the client
       // (robot_client/study/client_method.h).
       .methods = {"base", "ours", "null", "no_residual", "no_anchor", "dob", "dob_ours", "smooth",
                   "fewer_rows", "smooth_fewer_rows", "ours_following_step",
                   "ours_following_smooth", "ours_replanning"},
       .policies = {kPiperPolicy},
       .episodes_stand_alone = false}};
  return robots;
}

absl::StatusOr<RobotInfo> FindRobot(const std::string& name) {
  std::vector<std::string> known;
  for (const RobotInfo& robot : AllRobots()) {
    if (robot.name == name) return robot;
    known.push_back(robot.name);
  }
  return absl::NotFoundError(
      absl::StrCat("unknown robot '", name, "'; known: ", absl::StrJoin(known, ", ")));
}

std::vector<std::string> ScenariosOf(const RobotInfo& robot) {
  if (robot.arms.empty()) return ScenarioNames();
  std::vector<std::string> names;
  for (const auto& [name, title] : robot.arms) names.push_back(name);
  return names;
}

std::string ArmTitle(const std::string& scenario) {
  for (const RobotInfo& robot : AllRobots()) {
    for (const auto& [name, title] : robot.arms) {
      if (name == scenario) return title;
    }
  }
  return "";
}

}  // namespace robostress
