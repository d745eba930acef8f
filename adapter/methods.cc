#include "adapter/methods.h"

#include <map>
#include <set>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/config.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// Learning rates and the gain were chosen on the dev split (initial states 40-49, scenario
// dev_mixed); see docs/results/learning-rates.md. What a way needs beside is with its options.
constexpr double kRate = 1e-4;  // the paper's target, and its ablations
constexpr int kFewerRows = 2;
constexpr double kSmoothing = 0.4;  // docs/results/winning-back.md

struct Preset {
  const char* name;
  const char *title, *color;  // in tables and plots
  void (*apply)(MethodOptions&);
};

// Half the gain of what corrects once per chunk: success is the same, the gain margin twice as
// large.
void Smooth(MethodOptions& m) {
  m.Add(FollowingOptions::Tuned());
  m.Find<FollowingOptions>()->gain = 0.5;
  m.Add(IntegralOptions::Tuned(FollowingOptions::kIntegralThreshold));
  m.Add(EnvelopeOptions{.share = EnvelopeOptions::kShare});
  m.every_step = true;
  m.smoothing = kSmoothing;
}

constexpr Preset kPresets[] = {
    {"base", "Base", "#6b7280", [](MethodOptions&) {}},
    {"ours", "Ours", "#0072b2", [](MethodOptions& m) { m.Add(LoraOptions::At(kRate)); }},
    {"ours_intent", "Ours, target intent", "#d55e00",
     [](MethodOptions& m) {
       m.Add(LoraOptions::At(3e-5));
       m.target = TargetReference::kIntent;
       m.residual_scale = ResidualScale::kTracking;
     }},
    {"ours_nominal", "Ours, target nominal", "#009e73",
     [](MethodOptions& m) {
       m.Add(LoraOptions::At(3e-4));
       m.target = TargetReference::kNominal;
     }},
    {"ours_integral", "Ours, integral action", "#111827",
     [](MethodOptions& m) { m.Add(IntegralOptions::Tuned()); }},
    {"ours_following", "Ours, model following", "#dc2626",
     [](MethodOptions& m) {
       m.Add(FollowingOptions::Tuned());
       m.Add(IntegralOptions::Tuned(FollowingOptions::kIntegralThreshold));
     }},
    {"ours_following_step", "Ours, model following at every step", "#9f1239",
     [](MethodOptions& m) {
       m.Add(FollowingOptions::Tuned());
       m.Add(IntegralOptions::Tuned(FollowingOptions::kIntegralThreshold));
       m.every_step = true;
     }},
    {"ours_following_smooth", "Ours, model following, smoothed", "#7c2d12", Smooth},
    {"ours_replanning", "Ours, smoothed, two rows of a chunk", "#1d4ed8",
     [](MethodOptions& m) {
       Smooth(m);
       m.execute_steps = kFewerRows;
     }},
    {"ours_panda", "Ours, a nominal Panda", "#db2777",
     [](MethodOptions& m) {
       Smooth(m);
       m.execute_steps = kFewerRows;
       m.panda_dynamics = true;
     }},
    {"ours_learning", "Ours, learning what was sent", "#7e22ce",
     [](MethodOptions& m) {
       Smooth(m);
       m.execute_steps = kFewerRows;
       m.Add(LoraOptions::At(kRate));
       m.Find<LoraOptions>()->anchor_weight = 0.01;  // the paper's 1e-4 lets the norm grow on
       m.target = TargetReference::kSent;
     }},
    {"ours_identified", "Ours, identified and inverted", "#0f766e",
     [](MethodOptions& m) {
       m.every_step = true;
       m.smoothing = kSmoothing;
       m.execute_steps = kFewerRows;
       m.arm_model = "identified/{scenario}_found.yaml";
     }},
    {"known_errors", "Upper bound: errors known, inverted", "#a3a3a3",
     [](MethodOptions& m) {
       m.every_step = true;
       m.smoothing = kSmoothing;
       m.execute_steps = kFewerRows;
       m.arm_model = MethodOptions::kTrueModel;
     }},
    {"smooth", "Smoothing control", "#84cc16",
     [](MethodOptions& m) {
       m.every_step = true;
       m.smoothing = kSmoothing;
     }},
    {"fewer_rows", "Fewer rows control", "#0e7490",
     [](MethodOptions& m) { m.execute_steps = kFewerRows; }},
    {"smooth_fewer_rows", "Smoothing, fewer rows control", "#3f6212",
     [](MethodOptions& m) {
       m.every_step = true;
       m.smoothing = kSmoothing;
       m.execute_steps = kFewerRows;
     }},
    {"gain", "Gain control", "#e69f00", [](MethodOptions& m) { m.gain = 1.15; }},
    {"null", "Null control", "#cc79a7", [](MethodOptions& m) { m.noise_stream = "null"; }},
    {"direct", "Direct subtraction", "#56b4e9",
     [](MethodOptions& m) { m.Add(DirectOptions{.direct = true}); }},
    {"no_residual", "Ours w/o residual", "#8b5cf6",
     [](MethodOptions& m) {
       m.Add(LoraOptions::At(kRate));
       m.Find<LoraOptions>()->use_residual = false;
     }},
    {"no_anchor", "Ours w/o anchor", "#a16207",
     [](MethodOptions& m) {
       m.Add(LoraOptions::At(kRate));
       m.Find<LoraOptions>()->anchor_weight = 0;
     }},
    {"shuffled_instruction", "Shuffled instruction", "#be123c",
     [](MethodOptions& m) { m.observation = ObservationInput::kShuffledInstruction; }},
    {"blank_images", "Blank images", "#0f766e",
     [](MethodOptions& m) { m.observation = ObservationInput::kBlankImages; }},
    {"frozen_state", "Frozen state", "#4d7c0f",
     [](MethodOptions& m) { m.observation = ObservationInput::kFrozenState; }},
    {"dob", "Disturbance observer", "#56b4e9", [](MethodOptions& m) { m.observer = true; }},
    {"dob_ours", "Observer and ours", "#d55e00",
     [](MethodOptions& m) {
       m.Add(LoraOptions::At(kRate));
       m.observer = true;
     }},
};

const Preset* FindPreset(const std::string& name) {
  const Preset* found = absl::c_find_if(kPresets, [&](const Preset& p) { return name == p.name; });
  return found == std::end(kPresets) ? nullptr : found;
}

std::string KnownMethods() { return absl::StrJoin(MethodNames(), ", "); }

// Keys of an options struct, in order.
struct KeyLister {
  std::vector<std::string> keys;
  template <class T>
  void Field(const char* key, T&, const char*) {
    keys.emplace_back(key);
  }
  template <class T>
  void Late(const char* key, T&, const T&, const char*) {
    keys.emplace_back(key);
  }
  template <class E>
  void Choice(const char* key, E&, const std::vector<std::pair<const char*, E>>&, const char*) {
    keys.emplace_back(key);
  }
};

// Keys of Late that have another value than the usual one.
struct YoungerKeys {
  std::set<std::string> unusual;
  template <class T>
  void Field(const char*, T&, const char*) {}
  template <class E>
  void Choice(const char*, E&, const std::vector<std::pair<const char*, E>>&, const char*) {}
  template <class T>
  void Late(const char* key, T& value, const T& usual, const char*) {
    if (!(value == usual)) unusual.insert(key);
  }
};

// One way, as far as it matters here.
struct WayKeys {
  MethodWay way;
  std::vector<std::string> keys;
  bool present;
};

// Of every way, whether the method has it or not.
std::vector<WayKeys> WaysIn(const MethodOptions& options) {
  std::vector<WayKeys> result;
  std::apply(
      [&result](const auto&... way) {
        const auto add = [&result]<class Way>(const std::optional<Way>& held) {
          KeyLister lister;
          Way().Visit(lister);
          result.push_back({Way::kWay, lister.keys, held.has_value()});
        };
        (add(way), ...);
      },
      options.ways);
  return result;
}

// The options that do something in this method.
std::vector<std::string> KeysThatCount(const MethodOptions& options) {
  KeyLister all;
  MethodOptions copy = options;
  copy.Visit(all);
  for (const WayKeys& way : WaysIn(options)) {
    if (way.present) continue;
    std::erase_if(all.keys,
                  [&way](const auto& key) { return absl::c_linear_search(way.keys, key); });
  }
  return all.keys;
}

absl::Status CheckGiven(const std::string& source, const YAML::Node& given,
                        const MethodOptions& options) {
  std::set<std::string> keys;
  for (const auto& entry : given) keys.insert(entry.first.Scalar());
  for (const WayKeys& way : WaysIn(options)) {
    if (way.present || keys.contains(way.way.key)) continue;
    for (const std::string& key : way.keys) {
      if (!keys.contains(key)) continue;
      return absl::InvalidArgumentError(absl::StrCat(
          source, ": method ", options.method, " has no ", way.way.name, ", so ", key,
          " would change nothing; turn it on with ", way.way.key,
          ", or set what the method has: ", absl::StrJoin(KeysThatCount(options), ", ")));
    }
  }
  return absl::OkStatus();
}

// `given` over what `options` has.
absl::Status Read(const std::string& source, const YAML::Node& given, MethodOptions& options) {
  ConfigReader reader(source, given);
  options.Visit(reader);
  RS_RETURN_IF_ERROR(reader.Finish());
  return CheckGiven(source, given, options);
}

}  // namespace

const std::set<std::string>& YoungerKeysOf(const std::string& preset) {
  static const auto* const kKeys = [] {
    auto* keys = new std::map<std::string, std::set<std::string>>{{"", {}}};
    for (const Preset& each : kPresets) {
      MethodOptions options;
      each.apply(options);
      YoungerKeys younger;
      options.VisitOptions(younger);
      keys->emplace(each.name, younger.unusual);
    }
    return keys;
  }();
  const auto found = kKeys->find(preset);
  return found == kKeys->end() ? kKeys->at("") : found->second;
}

std::vector<std::string> MethodNames() {
  std::vector<std::string> names;
  for (const Preset& preset : kPresets) names.emplace_back(preset.name);
  return names;
}

std::string MethodTitle(const std::string& name) {
  const Preset* preset = FindPreset(name);
  return preset == nullptr ? name : preset->title;
}

std::string MethodColor(const std::string& name) {
  const Preset* preset = FindPreset(name);
  return preset == nullptr ? "#334155" : preset->color;
}

absl::Status OverrideMethod(const std::vector<std::string>& overrides, MethodOptions& options) {
  YAML::Node given(YAML::NodeType::Map);
  for (const std::string& assignment : overrides) {
    MethodOptions alone = options;  // so that the error names the override
    RS_RETURN_IF_ERROR(ApplyOverrides({assignment}, alone));
    RS_ASSIGN_OR_RETURN(const YAML::Node tree, config_internal::OverrideTree(assignment));
    for (const auto& entry : tree) given[entry.first.Scalar()] = entry.second;
  }
  return Read(absl::StrCat("override '", absl::StrJoin(overrides, " "), "'"), given, options);
}

absl::StatusOr<MethodOptions> MakeMethod(const std::string& name,
                                         const std::vector<std::string>& overrides) {
  const Preset* preset = FindPreset(name);
  if (preset == nullptr) {
    return absl::NotFoundError(
        absl::StrCat("unknown method '", name, "'; known: ", KnownMethods()));
  }
  MethodOptions options;
  options.method = name;
  preset->apply(options);
  RS_RETURN_IF_ERROR(OverrideMethod(overrides, options));
  if (options.method == name) return options;
  return absl::InvalidArgumentError(
      absl::StrCat("override 'method=", options.method, "' of method '", name,
                   "': it names another preset without its options; name it as the method"));
}

absl::StatusOr<MethodOptions> MakeMethodOf(const std::vector<std::string>& methods,
                                           const std::string& name,
                                           const std::vector<std::string>& overrides) {
  std::set<std::string> others;  // keys of ways that others have
  for (const std::string& method : methods) {
    RS_ASSIGN_OR_RETURN(const MethodOptions options, MakeMethod(method));
    for (const WayKeys& way : WaysIn(options)) {
      if (way.present) others.insert(way.keys.begin(), way.keys.end());
    }
  }
  RS_ASSIGN_OR_RETURN(const MethodOptions preset, MakeMethod(name));
  for (const std::string& key : KeysThatCount(preset)) others.erase(key);
  std::vector<std::string> meant;
  for (const std::string& assignment : overrides) {
    if (!others.contains(assignment.substr(0, assignment.find('=')))) meant.push_back(assignment);
  }
  return MakeMethod(name, meant);
}

absl::StatusOr<MethodOptions> ParseMethod(const std::string& source, const std::string& yaml) {
  RS_ASSIGN_OR_RETURN(const YAML::Node given, config_internal::ParseYaml(source, yaml));
  return ReadMethod(source, given);
}

absl::StatusOr<MethodOptions> ReadMethod(const std::string& source, const YAML::Node& given) {
  const YAML::Node name = given["method"];
  if (!name.IsDefined() || !name.IsScalar()) {
    return absl::InvalidArgumentError(absl::StrCat(
        source, ": names no method; set the key 'method' to one of: ", KnownMethods()));
  }
  absl::StatusOr<MethodOptions> options = MakeMethod(name.Scalar());
  if (!options.ok())
    return absl::InvalidArgumentError(absl::StrCat(source, ": ", options.status().message()));
  RS_RETURN_IF_ERROR(Read(source, given, *options));
  return options;
}

}  // namespace robostress
