#pragma once

#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "adapter/direct_subtraction.h"
#include "adapter/envelope.h"
#include "adapter/integral_action.h"
#include "adapter/leaky_goal.h"
#include "adapter/lora_options.h"
#include "adapter/model_following.h"
#include "adapter/pseudo_target.h"
#include "adapter/residual.h"
#include "adapter/residual_calibrator.h"

namespace robostress {

// The ways of compensating (method_way.h), in the order of their keys. A method has any set of
// them: `ours_following` is integral action and model following at once.
template <class... Options>
using WaysOf = std::tuple<std::optional<Options>...>;
using MethodWays = WaysOf<LoraOptions, DirectOptions, IntegralOptions, FollowingOptions,
                          LeakyGoalOptions, CalibratorOptions, EnvelopeOptions>;

// The younger keys (config.h, Late) in which a preset differs from what is usual; empty for a name
// that is none.
const std::set<std::string>& YoungerKeysOf(const std::string& preset);

// Writes a younger key that the method has as usual where its preset has it otherwise: a reader
// takes the preset's for a key that is not there.
template <class V>
struct OverPreset {
  V& v;
  const std::set<std::string>& younger;
  template <class T>
  void Field(const char* key, T& value, const char* doc) {
    v.Field(key, value, doc);
  }
  template <class E>
  void Choice(const char* key, E& value, const std::vector<std::pair<const char*, E>>& choices,
              const char* doc) {
    v.Choice(key, value, choices, doc);
  }
  template <class T>
  void Late(const char* key, T& value, const T& usual, const char* doc) {
    younger.contains(key) ? v.Field(key, value, doc) : v.Late(key, value, usual, doc);
  }
};

enum class ObservationInput { kFull, kShuffledInstruction, kBlankImages, kFrozenState };

// Everything that distinguishes one method from another: its ways, each with options of its own,
// and what every method has. As YAML it is one map of all keys; the keys of a way that it does not
// have stand there at their defaults, with the way off.
struct MethodOptions {
  std::string method = "base";  // the preset it started from (methods.h)
  MethodWays ways;
  double gain = 1.0;  // commands (gripper excluded) scaled by this before they are sent
  TargetReference target = TargetReference::kExecuted;
  ResidualScale residual_scale = ResidualScale::kCommand;
  double tracking_gain = 0.267;  // steady achieved/commanded displacement of the controller
  bool clip_command = true;      // residual against the command as the controller clips it, +-1
  std::string noise_stream = "policy";  // null control: another name, other sampling noise
  bool track_intent = true;             // also predict with the unadapted policy
  ObservationInput observation = ObservationInput::kFull;  // what the policy is shown
  // Corrects anew at every control step, by what the arm has done since the chunk was predicted.
  // Done beside the arm (CompensatedPolicy): a server hears of a chunk when it is over.
  bool every_step = false;
  // Share of the last sent command in the next, gripper excluded; done with every_step. A step of a
  // command makes a compliant transmission jump the other way first.
  double smoothing = 0;
  // Rows of a chunk that are executed before the next prediction; 0: as many as the policy says.
  int execute_steps = 0;
  // A scenario file with what was identified of this arm ({scenario}: the unit's), or kTrueModel:
  // commands are chosen by predictions with it, beside the arm. Empty: none.
  std::string arm_model;
  static constexpr char kTrueModel[] = "truth";
  // The nominal arm moves as robosuite's Panda does (panda_dynamics.h), not each axis by itself.
  bool panda_dynamics = false;
  bool observer = false;  // the robot's client corrects by its disturbance observer, not the server

  // Null: the method does not have this way.
  template <class Way>
  const Way* Find() const {
    const auto& way = std::get<std::optional<Way>>(ways);
    return way.has_value() ? &*way : nullptr;
  }
  template <class Way>
  Way* Find() {
    return const_cast<Way*>(std::as_const(*this).Find<Way>());
  }
  template <class Way>
  void Add(Way way) {
    std::get<std::optional<Way>>(ways) = std::move(way);
  }
  // Calls f(options) of every way that the method has.
  template <class F>
  void ForEachWay(const F& f) const {
    std::apply([&f](const auto&... way) { ((way.has_value() ? f(*way) : void()), ...); }, ways);
  }
  bool adapts() const { return Find<LoraOptions>() != nullptr; }
  bool ModelsArm() const;  // compares with a nominal arm
  bool Corrects() const;   // adds to commands by what it measured
  // Learns from motion, or corrects commands by it.
  bool Compensates() const;
  // Episodes depend on those before them.
  bool CarriesOver() const;

  // INVALID_ARGUMENT names method, option, value and range: options outside theirs, ways that
  // exclude each other.
  absl::Status Check() const;
  // INVALID_ARGUMENT where the method models an end-effector controller, or scales commands, and
  // `robot` takes joint targets.
  absl::Status CheckJointSpace(const std::string& robot) const;

  template <class V>
  void Visit(V& v) {
    v.Field("method", method, "the preset it starts from");
    OverPreset<V> over{v, YoungerKeysOf(method)};
    VisitOptions(over);
  }
  template <class V>
  void VisitOptions(V& v) {
    std::apply([&v](auto&... way) { (VisitWay(v, way), ...); }, ways);
    v.Field("gain", gain, "constant factor on every command, gripper excluded");
    v.Choice("target", target,
             {{"executed", TargetReference::kExecuted},
              {"intent", TargetReference::kIntent},
              {"nominal", TargetReference::kNominal},
              {"nominal_intent", TargetReference::kNominalIntent},
              {"sent", TargetReference::kSent}},
             "what the residual is taken against: the executed command (paper), the unadapted "
             "policy's, a nominal arm's response to the executed or to the unadapted one; sent: "
             "learn the command that was sent, corrections included");
    v.Choice("residual_scale", residual_scale,
             {{"command", ResidualScale::kCommand}, {"tracking", ResidualScale::kTracking}},
             "command: divide by the controller's scale (paper); tracking: also by tracking_gain");
    v.Field("tracking_gain", tracking_gain,
            "achieved/commanded displacement of a nominal arm at steady state");
    v.Field("clip_command", clip_command,
            "residual against the command clipped to +-1, as executed");
    v.Field("noise_stream", noise_stream, "name of the sampling noise stream");
    v.Field("track_intent", track_intent,
            "also predict with the unadapted policy, for the tracking of intent");
    v.Choice("observation", observation,
             {{"full", ObservationInput::kFull},
              {"shuffled_instruction", ObservationInput::kShuffledInstruction},
              {"blank_images", ObservationInput::kBlankImages},
              {"frozen_state", ObservationInput::kFrozenState}},
             "controls: another task's instruction, grey images, or the first proprioception for "
             "the whole episode");
    v.Late("every_step", every_step, false,
           "correct anew at every control step, not once per chunk; done beside the arm");
    v.Late("smoothing", smoothing, 0.0,
           "share of the last sent command in the next, gripper excluded; needs every_step");
    v.Late("execute_steps", execute_steps, 0,
           "rows of a chunk that are executed before the next prediction; 0: the policy's own");
    v.Late("arm_model", arm_model, std::string(),
           "chooses commands by predictions with a model of the arm: a scenario file with what was "
           "identified ({scenario} stands for the unit's), or truth: an upper bound; needs "
           "every_step");
    v.Late("panda_dynamics", panda_dynamics, false,
           "the nominal arm moves as robosuite's Panda does under OSC_POSE: a turn shifts its "
           "tool, a swing draws it in; false: each axis by itself");
    v.Late("observer", observer, false,
           "the robot's client corrects commands by its disturbance observer");
  }

 private:
  template <class V, class Way>
  static void VisitWay(V& v, std::optional<Way>& way) {
    Way options = way.value_or(Way());
    options.Visit(v);
    way.reset();
    if (options.on()) way = std::move(options);
  }
};

}  // namespace robostress
