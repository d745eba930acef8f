#include "eval/piper_study/piper_study.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/status_macros.h"
#include "eval/paper/piper_tables.h"

namespace robostress {
namespace {

constexpr char kExperiments[] = "main, dob, unseen";

absl::Status OutOfRange(const char* field, int64_t value, int64_t low, int64_t high) {
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, ", must be ", low, " to ", high));
}

bool Wants(const PiperStudyOptions& options, const char* experiment) {
  return std::find(options.experiments.begin(), options.experiments.end(), experiment) !=
         options.experiments.end();
}

absl::Status CheckOptions(const PiperStudyOptions& options) {
  if (options.arms.empty() || options.tasks.empty() || options.experiments.empty())
    return absl::InvalidArgumentError("arms, tasks and experiments must not be empty");
  for (const int task : options.tasks) {
    if (task < 1 || task > 4) return OutOfRange("a value of tasks", task, 1, 4);
  }
  for (const std::string& name : options.experiments) {
    if (name != "main" && name != "dob" && name != "unseen") {
      return absl::InvalidArgumentError(
          absl::StrCat("experiments: '", name, "' is unknown; there are ", kExperiments));
    }
  }
  if (options.demonstrations < 1 || options.demonstrations > 1000)
    return OutOfRange("demonstrations", options.demonstrations, 1, 1000);
  if (options.episodes < 1 || options.episodes > 1000)
    return OutOfRange("episodes", options.episodes, 1, 1000);
  if (options.train_steps < 1) return OutOfRange("train_steps", options.train_steps, 1, 1 << 30);
  if (options.tune_steps < 1) return OutOfRange("tune_steps", options.tune_steps, 1, 1 << 30);
  if (Wants(options, "unseen") && options.episodes % 5 != 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("episodes is ", options.episodes,
                     ", the five object variants of 'unseen' need a multiple of 5"));
  }
  if (options.base_weights.empty() != options.robust_weights.empty()) {
    return absl::InvalidArgumentError(
        "base_weights and robust_weights go together: give both, or neither and both are trained");
  }
  const std::string base = PolicyLabel(options.base_weights);
  if (!base.empty() && base == PolicyLabel(options.robust_weights)) {
    return absl::InvalidArgumentError(
        absl::StrCat("base_weights and robust_weights are both called '", base,
                     "', and units are called by it: give one file another name"));
  }
  return absl::OkStatus();
}

// The grid with those of its methods that adapt, or that do not.
absl::StatusOr<SweepGrid> WithMethods(SweepGrid grid, bool adapts,
                                      const std::vector<std::string>& overrides, PolicyHome home) {
  std::vector<std::string> methods;
  for (const std::string& name : grid.methods) {
    RS_ASSIGN_OR_RETURN(const MethodOptions method, MakeMethod(name));
    if (method.adapts() == adapts) methods.push_back(name);
  }
  grid.methods = methods;
  if (methods.empty()) return grid;
  if (adapts) {
    for (const std::string& assignment : overrides)
      grid.overrides.push_back("method." + assignment);
  }
  return ResolveGrid(std::move(grid), home);
}

}  // namespace

const char* const kPiperTasks[4] = {"bowl_next_to_plate", "bowl_on_cabinet", "bowl_on_box",
                                    "open_drawer"};

PiperStudyOptions QuickPiperStudy() {
  PiperStudyOptions options;
  options.arms = {"new"};
  options.tasks = {1};
  options.demonstrations = 2;
  options.episodes = 5;
  options.episode_s = 4;
  options.train_steps = 20;
  options.tune_steps = 4;
  return options;
}

PaperProtocol ProtocolOf(const PiperStudyOptions& options, const std::string& out) {
  PaperProtocol protocol = PiperProtocol(out);
  if (!options.base_weights.empty()) {
    protocol.base = options.base_weights;
    protocol.robust = options.robust_weights;
  }
  protocol.grid.episodes = options.episodes;
  protocol.grid.seeds = {options.seed};
  protocol.grid.overrides = {absl::StrCat("client.episode_s=", options.episode_s),
                             absl::StrCat("client.moved_bound=", options.moved_bound)};
  return protocol;
}

absl::StatusOr<std::vector<PiperTablePlan>> PlanPiperStudy(const PiperStudyOptions& options,
                                                           const PaperProtocol& protocol,
                                                           PolicyHome home) {
  RS_RETURN_IF_ERROR(CheckOptions(options));
  RS_RETURN_IF_ERROR(MakeMethod("ours", options.overrides).status());
  const std::vector<PiperArmColumn> arms = PiperArms(options.arms);
  std::vector<PaperTable> tables;
  // What the observer and the variants are compared with comes first.
  if (Wants(options, "dob")) tables.push_back(ObserverTable(arms[0], options.tasks[0]));
  if (Wants(options, "main")) tables.push_back(RealArmTable(arms, options.tasks));
  if (Wants(options, "unseen")) tables.push_back(UnseenTable(arms[0]));
  std::vector<PiperTablePlan> plans;
  for (const PaperTable& table : tables) {
    PiperTablePlan plan{table, {}};
    RS_ASSIGN_OR_RETURN(const std::vector<SweepGrid> grids, PaperGrids(table, protocol, home));
    for (const SweepGrid& grid : grids) {
      for (const bool adapts : {false, true}) {
        RS_ASSIGN_OR_RETURN(const SweepGrid part,
                            WithMethods(grid, adapts, options.overrides, home));
        if (!part.methods.empty()) plan.grids.push_back(part);
      }
    }
    plans.push_back(std::move(plan));
  }
  return plans;
}

absl::StatusOr<std::vector<PiperTablePlan>> PlanOf(const PiperStudyOptions& options,
                                                   const PiperStudyLaunch& launch,
                                                   PolicyHome home) {
  PaperProtocol protocol = ProtocolOf(options, launch.out);
  if (launch.real_time) {
    protocol.grid.overrides.push_back("client.real_time=true");
    protocol.grid.overrides.push_back(absl::StrCat("client.udp_port=", launch.udp_port));
  }
  return PlanPiperStudy(options, protocol, home);
}

}  // namespace robostress
