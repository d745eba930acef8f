#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

enum class ResidualScale { kCommand, kTracking };
enum class TargetReference { kExecuted, kIntent, kNominal };
enum class LoraKind { kPerHead, kPerMatrix };
enum class ExecutionMode { kLockstep, kAsync };
enum class IntegralAxes { kAll, kTranslation };
enum class FollowingAxes { kTranslation, kHorizontal };
enum class ObservationInput { kFull, kShuffledInstruction, kBlankImages, kFrozenState };

// Everything that distinguishes one method from another; the defaults are the paper's (sec:supp_method,
// sec:supp_lora) except learning_rate, which is nano's, chosen on the dev split.
struct MethodOptions {
  std::string method = "base";       // the preset it started from
  bool adapt = false;                // online LoRA updates
  LoraKind lora = LoraKind::kPerHead;  // how q and o are factored (adapter/README.md)
  int rank = 4;
  double lora_init_std = 0.01;
  double learning_rate = 1e-6;
  double beta1 = 0.9, beta2 = 0.999, adam_epsilon = 1e-8;
  double clip_norm = 1.0;
  double anchor_weight = 1e-4;       // lambda_anc; 0 in no_anchor
  int buffer_chunks = 32;
  int update_interval = 8;
  int batch = 4;
  bool use_residual = true;          // false: eta = 0 (no_residual)
  bool direct = false;               // subtract the previous chunk's mean residual, no updates
  double integral_rate = 0;          // k of IntegralAction, per control step; 0: none
  double integral_limit = 0.2;       // bound of its estimate on each axis [command units]
  double integral_threshold = 0;     // smaller estimates correct nothing [command units]
  IntegralAxes integral_axes = IntegralAxes::kAll;
  bool integral_carry = false;       // the estimate outlives its episode
  double following_gain = 0;         // K of ModelFollowing, command per shortfall; 0: none
  double following_memory = 20;      // [control steps] that a shortfall counts
  double following_threshold = 0;    // a smaller shortfall corrects nothing [command units]
  double following_limit = 0.5;      // bound of its correction on each axis [command units]
  FollowingAxes following_axes = FollowingAxes::kTranslation;
  double gain = 1.0;                 // commands (gripper excluded) scaled by this before they are sent
  TargetReference target = TargetReference::kExecuted;
  ResidualScale residual_scale = ResidualScale::kCommand;
  double tracking_gain = 0.267;      // steady achieved/commanded displacement of the controller
  bool clip_command = true;          // residual against the command as the controller clips it, +-1
  std::string noise_stream = "policy";  // null control: another name, other sampling noise
  bool track_intent = true;          // also predict with the unadapted policy
  ObservationInput observation = ObservationInput::kFull;  // what the policy is shown
  bool observer = false;  // the robot's client corrects by its disturbance observer; the server does nothing

  // Episodes depend on those before them.
  bool CarriesOver() const { return adapt || (integral_rate > 0 && integral_carry); }

  template <class V>
  void Visit(V& v) {
    v.Field("method", method, "preset: base, ours, ours_intent, ours_nominal, ours_integral, ours_following, direct, no_residual, no_anchor, gain, null, shuffled_instruction, blank_images, frozen_state, dob, dob_ours");
    v.Field("adapt", adapt, "update the LoRA online");
    v.Choice("lora", lora, {{"per_head", LoraKind::kPerHead}, {"per_matrix", LoraKind::kPerMatrix}},
             "per_head: a pair of factors for each attention head (openpi, the paper); per_matrix: one for each matrix (PEFT)");
    v.Field("rank", rank, "LoRA rank");
    v.Field("lora_init_std", lora_init_std, "standard deviation of A at the start (B = 0)");
    v.Field("learning_rate", learning_rate, "Adam step size");
    v.Field("beta1", beta1, "Adam");
    v.Field("beta2", beta2, "Adam");
    v.Field("adam_epsilon", adam_epsilon, "Adam");
    v.Field("clip_norm", clip_norm, "global L2 norm of the gradient");
    v.Field("anchor_weight", anchor_weight, "lambda_anc of ||phi - phi_0||^2");
    v.Field("buffer_chunks", buffer_chunks, "FIFO length [chunks]");
    v.Field("update_interval", update_interval, "chunks between updates once the buffer is full");
    v.Field("batch", batch, "chunks per update, without replacement");
    v.Field("use_residual", use_residual, "false: the policy's own commands are the targets");
    v.Field("direct", direct, "subtract the previous chunk's mean residual from the next chunk");
    v.Field("integral_rate", integral_rate, "integral action: share of the newest disturbance in the estimate, per control step; 0: none");
    v.Field("integral_limit", integral_limit, "bound of the estimated disturbance on each axis [command units]");
    v.Field("integral_threshold", integral_threshold, "estimates below it correct nothing, larger ones d by d - threshold^2 / d [command units]");
    v.Choice("integral_axes", integral_axes, {{"all", IntegralAxes::kAll}, {"translation", IntegralAxes::kTranslation}},
             "axes whose disturbance is estimated and subtracted");
    v.Field("integral_carry", integral_carry, "keep the estimate across episodes");
    v.Field("following_gain", following_gain, "model following: command per distance that the arm is behind a nominal one [command units]; 0: none");
    v.Field("following_memory", following_memory, "control steps after which a distance fallen behind is forgotten to 1/e");
    v.Field("following_threshold", following_threshold, "a distance below it corrects nothing, a larger one e by e - threshold^2 / e [command units]");
    v.Field("following_limit", following_limit, "bound of its correction on each axis [command units]");
    v.Choice("following_axes", following_axes, {{"translation", FollowingAxes::kTranslation}, {"horizontal", FollowingAxes::kHorizontal}},
             "axes that follow; horizontal: x and y of the base frame");
    v.Field("gain", gain, "constant factor on every command, gripper excluded");
    v.Choice("target", target,
             {{"executed", TargetReference::kExecuted}, {"intent", TargetReference::kIntent}, {"nominal", TargetReference::kNominal}},
             "what the residual is taken against: the executed command (paper), the unadapted policy's, a nominal arm's response");
    v.Choice("residual_scale", residual_scale,
             {{"command", ResidualScale::kCommand}, {"tracking", ResidualScale::kTracking}},
             "command: divide by the controller's scale (paper); tracking: also by tracking_gain");
    v.Field("tracking_gain", tracking_gain, "achieved/commanded displacement of a nominal arm at steady state");
    v.Field("clip_command", clip_command, "residual against the command clipped to +-1, as executed");
    v.Field("noise_stream", noise_stream, "name of the sampling noise stream");
    v.Field("track_intent", track_intent, "also predict with the unadapted policy, for the tracking of intent");
    v.Choice("observation", observation,
             {{"full", ObservationInput::kFull}, {"shuffled_instruction", ObservationInput::kShuffledInstruction},
              {"blank_images", ObservationInput::kBlankImages}, {"frozen_state", ObservationInput::kFrozenState}},
             "controls: another task's instruction, grey images, or the first proprioception for the whole episode");
    v.Late("observer", observer, false, "the robot's client corrects commands by its disturbance observer");
  }
};

// Names in the order of the tables.
std::vector<std::string> MethodNames();
// A preset with "key=value" overrides applied; unknown names list the known ones. The preset's name itself is no
// override: INVALID_ARGUMENT.
absl::StatusOr<MethodOptions> MakeMethod(const std::string& name, const std::vector<std::string>& overrides = {});
// A method as YAML text: the preset that its key `method` names, and over it every other key that is given. So
// "method: ours" adapts, and a dump of all options reads back to the same bits. INVALID_ARGUMENT names `source` and
// lists what is known: no map, no or an unknown `method`, an unknown key, a value of the wrong type.
absl::StatusOr<MethodOptions> ParseMethod(const std::string& source, const std::string& yaml);

}  // namespace robostress
