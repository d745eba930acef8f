#include "robot_client/study/table_suites.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/joint_errors/scenario_file.h"
#include "common/status_macros.h"
#include "common/unit/unit_plan.h"
#include "robot_client/emulator/wear_profile.h"
#include "robot_client/study/client_method.h"
#include "robot_client/study/table_tasks.h"

namespace robostress::piper {
namespace {

const std::vector<TableSuite>& TableSuites() {
  static const auto& suites =
      *new std::vector<TableSuite>{{"piper_1_next_to_plate", 0, {0}},
                                   {"piper_2_on_cabinet", 1, {0}},
                                   {"piper_3_on_box", 2, {0}},
                                   {"piper_4_open_drawer", 3, {0}},
                                   // One session over five variants (paper, sec:supp_real).
                                   {"piper_unseen", 0, {1, 2, 3, 4, 5}}};
  return suites;
}

}  // namespace

absl::StatusOr<TableSuite> FindTableSuite(const std::string& name) {
  std::vector<std::string> known;
  for (const TableSuite& suite : TableSuites()) {
    if (suite.name == name) return suite;
    known.emplace_back(suite.name);
  }
  return absl::NotFoundError(absl::StrCat(
      "suite '", name, "' is none of the Piper's table; there are ", absl::StrJoin(known, ", ")));
}

std::string InstructionOf(const TableSuite& suite, int variant) {
  return variant == 0 ? kTableTasks.at(static_cast<size_t>(suite.task)).instruction
                      : kObjectVariants.at(static_cast<size_t>(variant)).instruction;
}

absl::StatusOr<UnitConfig> ResolvePiperUnit(const UnitConfig& unit) {
  RS_ASSIGN_OR_RETURN(UnitConfig resolved, ResolveUnit(unit));
  RS_RETURN_IF_ERROR(FindTableSuite(unit.suite).status());
  RS_RETURN_IF_ERROR(MakeWearProfile(unit.scenario).status());
  if (RunsInWorker(unit.policy)) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: policy is '", unit.policy, "', must be one that a server holds"));
  }
  if (unit.videos > 0) {
    return absl::InvalidArgumentError(absl::StrCat("unit: videos is ", unit.videos,
                                                   ", must be 0: a Piper's units have no films"));
  }
  if (unit.method->panda_dynamics) {
    return absl::InvalidArgumentError(
        "method.panda_dynamics is true; a Piper acts in joint space: set it to false");
  }
  const ClientOptions& client = unit.client;
  if (!(client.episode_s > 0 && client.episode_s <= 600)) {
    return absl::InvalidArgumentError(absl::StrCat("client.episode_s is ", client.episode_s,
                                                   ", must be above 0 and at most 600"));
  }
  if (!(client.moved_bound > 0 && client.moved_bound <= 1)) {
    return absl::InvalidArgumentError(absl::StrCat("client.moved_bound is ", client.moved_bound,
                                                   ", must be above 0 and at most 1"));
  }
  if (client.direct && client.real_time) {
    return absl::InvalidArgumentError(
        "client.direct is true with client.real_time; it is played in simulated time only");
  }
  if (client.latency_ticks < 0 || client.latency_ticks > 30) {
    return absl::InvalidArgumentError(
        absl::StrCat("client.latency_ticks is ", client.latency_ticks, ", must be 0 to 30"));
  }
  return resolved;
}

PolicyConnectionOptions SessionOf(const UnitConfig& unit, const std::string& server) {
  PolicyConnectionOptions session;
  session.server = server;
  session.policy = unit.policy;
  session.scenario = ScenarioLabel(unit.scenario);
  session.robot = absl::StrCat("piper_", session.scenario);
  session.suite = "piper_table";
  session.seed = unit.seed;
  session.method = ServersPart(*unit.method);
  return session;
}

}  // namespace robostress::piper
