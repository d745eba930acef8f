#include "eval/piper_study/piper_study.h"

#include <algorithm>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "common/config.h"
#include "common/method_options.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr char kExperiments[] = "main, dob, unseen";

absl::Status OutOfRange(const char* field, int64_t value, int64_t low, int64_t high) {
  return absl::InvalidArgumentError(
      absl::StrCat(field, " is ", value, ", must be ", low, " to ", high));
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
  if (options.base_weights.empty() != options.robust_weights.empty()) {
    return absl::InvalidArgumentError(
        "base_weights and robust_weights go together: give both, or neither and both are trained");
  }
  return absl::OkStatus();
}

bool Wants(const PiperStudyOptions& options, const char* experiment) {
  return std::find(options.experiments.begin(), options.experiments.end(), experiment) !=
         options.experiments.end();
}

}  // namespace

const char* const kPiperTasks[4] = {"bowl_next_to_plate", "bowl_on_cabinet", "bowl_on_box",
                                    "open_drawer"};
const char* const kPiperVariants[6] = {"gray",       "wooden",       "plum",
                                       "light_blue", "yellow_plate", "green_plate"};

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

absl::StatusOr<std::vector<PiperUnit>> PlanPiperStudy(const PiperStudyOptions& options) {
  RS_RETURN_IF_ERROR(CheckOptions(options));
  RS_RETURN_IF_ERROR(MakeMethod("ours", options.overrides).status());
  std::vector<PiperUnit> units;
  std::set<std::string> planned;
  const auto add = [&](const char* experiment, const std::string& arm, int task,
                       const char* method) {
    PiperUnit unit{absl::StrCat(experiment, "_", arm, "_", task, "_", method), experiment, arm,
                   task, method};
    if (planned.insert(unit.id).second) units.push_back(std::move(unit));
  };
  const std::string& first_arm = options.arms[0];
  const int first_task = options.tasks[0];
  // What the observer and the variants are compared with comes first.
  if (Wants(options, "dob")) {
    for (const char* method : {"base", "ours"}) add("main", first_arm, first_task, method);
    for (const char* method : {"dob", "dob_ours"}) add("dob", first_arm, first_task, method);
  }
  if (Wants(options, "main")) {
    for (const std::string& arm : options.arms) {
      for (const int task : options.tasks) {
        for (const char* method : {"base", "robust", "ours"}) add("main", arm, task, method);
      }
    }
  }
  if (Wants(options, "unseen")) {
    if (options.episodes % 5 != 0) {
      return absl::InvalidArgumentError(
          absl::StrCat("episodes is ", options.episodes,
                       ", the five object variants of 'unseen' need a multiple of 5"));
    }
    for (const char* method : {"base", "robust", "ours"}) add("unseen", first_arm, 1, method);
  }
  return units;
}

absl::StatusOr<std::string> PiperUnitYaml(const PiperStudyOptions& options, const PiperUnit& unit,
                                          const std::string& policy) {
  const bool adapts = unit.method == "ours" || unit.method == "dob_ours";
  RS_ASSIGN_OR_RETURN(MethodOptions method,
                      MakeMethod(adapts ? "ours" : "base",
                                 adapts ? options.overrides : std::vector<std::string>()));
  std::string variants = kPiperVariants[0];
  if (unit.experiment == "unseen")
    variants = absl::StrJoin(std::begin(kPiperVariants) + 1, std::end(kPiperVariants), ", ");
  const bool observer = unit.method == "dob" || unit.method == "dob_ours";
  std::string section = absl::StrCat("\n", DumpConfig(method));
  while (!section.empty() && section.back() == '\n') section.pop_back();
  return absl::StrCat("arm: ", unit.arm, "\ntask: ", kPiperTasks[unit.task - 1], "\nvariants: [",
                      variants, "]\nepisodes: ", options.episodes,
                      "\nepisode_s: ", options.episode_s,
                      "\nobserver: ", observer ? "true" : "false", "\nseed: ", options.seed,
                      "\nmoved_bound: ", options.moved_bound, "\npolicy: \"", policy,
                      "\"\nmethod:", absl::StrReplaceAll(section, {{"\n", "\n  "}}), "\n");
}

}  // namespace robostress
