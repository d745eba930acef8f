#include "server/policies/openpi/policy_setup.h"

#include <algorithm>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace robostress::openpi {
namespace {

constexpr int64_t kExecuteSteps = 5;  // openpi's LIBERO client, and the paper's n_exec
constexpr int64_t kEulerSteps = 10;

bool IsLerobot(const Checkpoint& checkpoint) {
  return checkpoint.layout != CheckpointLayout::kOpenpi ||
         checkpoint.declared.writer == CheckpointConfig::Writer::kLerobot;
}

bool Decide(Setting setting, bool automatic) {
  return setting == Setting::kAuto ? automatic : setting == Setting::kYes;
}

// LeRobot's name of a normalisation; `key` is STATE or ACTION.
absl::StatusOr<NormKind> DeclaredNorm(const CheckpointConfig& declared, const std::string& key,
                                      NormKind otherwise) {
  const auto found = declared.normalization.find(key);
  if (found == declared.normalization.end()) return otherwise;
  if (found->second == "MEAN_STD") return NormKind::kZScore;
  if (found->second == "QUANTILES") return NormKind::kQuantile;
  if (found->second == "IDENTITY") return NormKind::kNone;
  return absl::InvalidArgumentError(absl::StrCat(
      declared.file, ": normalization_mapping ", key, " is '", found->second,
      "', must be MEAN_STD, QUANTILES or IDENTITY; set normalisation to say what is meant"));
}

absl::StatusOr<NormKind> ChooseNorm(const Checkpoint& checkpoint, NormSetting setting,
                                    const std::string& key) {
  switch (setting) {
    case NormSetting::kNone:
      return NormKind::kNone;
    case NormSetting::kZScore:
      return NormKind::kZScore;
    case NormSetting::kQuantile:
      return NormKind::kQuantile;
    case NormSetting::kAuto:
      return DeclaredNorm(checkpoint.declared, key,
                          checkpoint.config.pi05 ? NormKind::kQuantile : NormKind::kZScore);
  }
  return NormKind::kNone;
}

// Collects what one step after the other finds wrong.
class Resolver {
 public:
  Resolver(const Checkpoint& checkpoint, const PolicyOptions& options)
      : checkpoint_(checkpoint), options_(options), lerobot_(IsLerobot(checkpoint)) {}

  SetupResult Resolve() {
    ChooseRobot();
    ReadStats();
    ChooseSizes();
    ChooseNormalisation();
    ChoosePrompt();
    ChooseSteps();
    return std::move(result_);
  }

 private:
  void Problem(std::string text) { result_.problems.push_back(std::move(text)); }

  void ChooseRobot() {
    std::string name = options_.transform;
    if (name == "auto") {
      std::string asset = options_.asset_id;
      if (asset.empty() && checkpoint_.norm_stats.size() == 1)
        asset = checkpoint_.norm_stats[0].asset_id;
      name = absl::StrContains(asset, "libero") ? "libero" : "plain";
    }
    absl::StatusOr<RobotTransform> robot = FindRobotTransform(name);
    if (!robot.ok()) return Problem(std::string(robot.status().message()));
    setup_.robot = *std::move(robot);
    if (options_.cameras.size() == kImageSlots.size())
      std::copy(options_.cameras.begin(), options_.cameras.end(), setup_.robot.cameras.begin());
    std::set<std::string> seen;
    for (const std::string& camera : setup_.robot.cameras) {
      if (!camera.empty() && !seen.insert(camera).second)
        Problem(absl::StrCat("cameras: '", camera, "' is in two slots"));
    }
    if (seen.empty()) Problem("cameras: all three slots are empty, the policy would be blind");
    const RobotTransform& r = setup_.robot;
    setup_.delta =
        Decide(options_.delta, !lerobot_ && (checkpoint_.config.pi05 ? r.pi05_delta : r.pi0_delta));
  }

  void ReadStats() {
    if (options_.normalisation == NormSetting::kNone) return;
    absl::StatusOr<NormStats> stats = options_.norm_stats.empty()
                                          ? ReadNormStats(checkpoint_, options_.asset_id)
                                          : ReadNormStatsJson(options_.norm_stats);
    if (stats.ok()) {
      setup_.stats = *std::move(stats);
    } else {
      Problem(std::string(stats.status().message()));
    }
  }

  const FieldStats* Find(const std::string& field) const {
    const auto found = setup_.stats.fields.find(field);
    return found == setup_.stats.fields.end() ? nullptr : &found->second;
  }

  // Entries of state or action: the robot's, else what LeRobot declares, else what was recorded.
  int64_t Dims(const char* field, int64_t robot, std::optional<int64_t> declared) {
    const int64_t room = checkpoint_.config.action_dim;
    const FieldStats* stats = Find(field);
    int64_t dims = room;
    if (robot > 0) {
      dims = robot;
    } else if (declared) {
      dims = *declared;
    } else if (stats != nullptr && stats->dims() > 0) {
      dims = static_cast<int64_t>(stats->dims());
    }
    if (dims > room) {
      Problem(absl::StrCat("transform ", setup_.robot.name, " has ", dims, " entries of ", field,
                           ", the network has room for ", room));
      dims = room;
    }
    return dims;
  }

  void ChooseSizes() {
    RobotTransform& r = setup_.robot;
    r.state_dim = Dims("state", r.state_dim, checkpoint_.declared.robot_state_dim);
    r.action_dim = Dims("actions", r.action_dim, checkpoint_.declared.robot_action_dim);
    if (r.delta_dims == 0) r.delta_dims = r.action_dim - 1;
    if (setup_.delta && r.delta_dims > std::min(r.state_dim, r.action_dim)) {
      Problem(absl::StrCat("delta: ", r.delta_dims,
                           " action entries would be relative to a state of ", r.state_dim,
                           "; set delta to false or choose another transform"));
    }
  }

  Normaliser MakeNormaliser(const char* field, const char* key, int64_t dims) {
    const absl::StatusOr<NormKind> kind = ChooseNorm(checkpoint_, options_.normalisation, key);
    if (!kind.ok()) {
      Problem(std::string(kind.status().message()));
      return Normaliser::Identity();
    }
    if (*kind == NormKind::kNone || setup_.stats.source.empty()) return Normaliser::Identity();
    const FieldStats* stats = Find(field);
    if (stats == nullptr) {
      Problem(absl::StrCat(setup_.stats.source, ": holds no statistics of '", field, "'"));
      return Normaliser::Identity();
    }
    absl::StatusOr<Normaliser> made =
        Normaliser::Create(absl::StrCat(setup_.stats.source, ": '", field, "'"), *stats, *kind,
                           setup_.convention, dims);
    if (!made.ok()) Problem(std::string(made.status().message()));
    return made.ok() ? *std::move(made) : Normaliser::Identity();
  }

  void ChooseNormalisation() {
    setup_.convention = lerobot_ ? NormConvention::kLerobot : NormConvention::kOpenpi;
    setup_.state = MakeNormaliser("state", "STATE", setup_.robot.state_dim);
    setup_.actions = MakeNormaliser("actions", "ACTION", setup_.robot.action_dim);
  }

  void ChoosePrompt() {
    const OpenpiConfig& config = checkpoint_.config;
    const bool with_state = Decide(options_.discrete_state,
                                   config.pi05 && (lerobot_ || setup_.robot.pi05_state_in_prompt));
    if (with_state && !config.pi05)
      Problem("discrete_state is set, but pi0 takes its state as a token; set it to false");
    setup_.prompt = with_state ? PromptFormat::kTextAndState : PromptFormat::kText;
    setup_.prompt_has_padded_state = lerobot_;
    setup_.prompt_tokens = config.prompt_tokens;
    const bool interpolate = options_.resize == ResizeSetting::kInterpolate ||
                             (options_.resize == ResizeSetting::kAuto && lerobot_);
    setup_.resize = interpolate ? ResizeFilter::kInterpolate : ResizeFilter::kPillow;
    absl::StatusOr<std::string> tokenizer =
        FindTokenizer(options_.tokenizer, CheckpointFolder(checkpoint_.path));
    if (tokenizer.ok()) {
      setup_.tokenizer = *std::move(tokenizer);
    } else {
      Problem(std::string(tokenizer.status().message()));
    }
  }

  void ChooseSteps() {
    const int64_t horizon = checkpoint_.config.horizon;
    setup_.execute_steps =
        options_.execute_steps > 0 ? options_.execute_steps : std::min(kExecuteSteps, horizon);
    if (setup_.execute_steps > horizon) {
      Problem(absl::StrCat("execute_steps is ", setup_.execute_steps, ", a chunk has ", horizon));
    }
    setup_.euler_steps = options_.euler_steps > 0
                             ? options_.euler_steps
                             : checkpoint_.declared.euler_steps.value_or(kEulerSteps);
  }

  const Checkpoint& checkpoint_;
  const PolicyOptions& options_;
  const bool lerobot_;
  SetupResult result_;
  PolicySetup& setup_ = result_.setup;
};

}  // namespace

CheckpointOptions NetworkOptions(const PolicyOptions& options) {
  CheckpointOptions network;
  if (options.horizon > 0) network.horizon = options.horizon;
  if (options.prompt_tokens > 0) network.prompt_tokens = options.prompt_tokens;
  return network;
}

SetupResult ResolveSetup(const Checkpoint& checkpoint, const PolicyOptions& options) {
  return Resolver(checkpoint, options).Resolve();
}

}  // namespace robostress::openpi
