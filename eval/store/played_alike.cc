#include "eval/store/played_alike.h"

#include <bit>
#include <cstdint>
#include <type_traits>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/json_text.h"
#include "common/libero/fixtures.h"
#include "common/libero/own_tasks.h"
#include "common/libero/task_folder.h"
#include "common/suites.h"
#include "common/unit/robots.h"
#include "common/unit/unit_directory.h"
#include "eval/plan/plan.h"

namespace robostress {
namespace {

constexpr char kPlayed[] = "sha256 ";  // before the hash of what a unit was played with

void Flatten(const YAML::Node& node, const std::string& path, FlatOptions& options) {
  if (node.IsMap()) {
    for (const auto& entry : node) {
      const std::string key = entry.first.as<std::string>();
      Flatten(entry.second, path.empty() ? key : absl::StrCat(path, ".", key), options);
    }
  } else if (node.IsSequence()) {
    std::vector<std::string> items;
    for (const YAML::Node& item : node)
      items.push_back(item.IsScalar() ? item.Scalar() : YAML::Dump(item));
    if (!items.empty()) options[path] = absl::StrJoin(items, ",");
  } else if (node.IsScalar() && !node.Scalar().empty()) {
    options[path] = node.Scalar();
  }
}

// A path says where a file lies on somebody's machine; its content decides, as it was when the unit
// was played where that is known.
std::string FileOrWord(const std::string& value) {
  if (absl::StartsWith(value, kPlayed) || !NamesFixtureTable(value)) return value;
  const absl::StatusOr<std::string> hash = Sha256OfFile(value);
  return hash.ok() ? absl::StrCat(kPlayed, *hash) : "that is gone";
}

std::string TaskFolderHash(const std::string& path) {
  if (absl::StartsWith(path, kPlayed)) return path;
  const absl::StatusOr<std::string> hash = LiberoTasksSha256(path);
  return hash.ok() ? absl::StrCat(kPlayed, *hash) : "that is gone";
}

std::string OwnTasksHash(const std::string& path) {
  return absl::StrCat(kPlayed, LiberosOwnSha256(path));
}

// A unit without what ProtocolOf leaves out.
UnitConfig ProtocolUnit(const UnitConfig& unit) {
  const UnitConfig usual;
  UnitConfig config = unit;
  config.scenario.clear();
  config.policy.clear();
  config.replay_file.clear();
  config.libero_root.clear();
  config.robosuite_root.clear();
  config.libero_fixtures = FileOrWord(config.libero_fixtures);
  if (!config.libero_tasks.empty()) config.libero_tasks = TaskFolderHash(config.libero_tasks);
  config.remote = {};
  config.suite = usual.suite, config.severity = usual.severity, config.seed = usual.seed;
  config.videos = usual.videos, config.method = usual.method;
  return config;
}

// Which episodes a unit has decides how many pair, and no outcome.
UnitConfig SuiteUnit(const UnitConfig& unit) {
  const UnitConfig usual;
  UnitConfig config = ProtocolUnit(unit);
  config.tasks = usual.tasks, config.episodes = usual.episodes;
  config.first_initial_state = usual.first_initial_state;
  return config;
}

UnitConfig MethodUnit(const UnitConfig& unit) {
  UnitConfig config;
  config.method = unit.method;
  return config;
}

UnitConfig RemoteUnit(const UnitConfig& unit) {
  UnitConfig config;
  config.remote = unit.remote;
  // A key may stand in a query.
  std::string& path = config.remote.dialect.path;
  path = path.substr(0, path.find('?'));
  return config;
}

UnitConfig ScenarioUnit(const UnitConfig& unit) {
  UnitConfig config;
  config.scenario = ScenarioHash(unit).substr(0, 12);
  return config;
}

// Every value of a configuration, one behind the other: two that are equal have equal texts, at a
// hundredth of what YAML costs.
class ValueText {
 public:
  template <class T>
  void Field(const char*, T& value, const char*) {
    if constexpr (std::is_same_v<T, double>) {
      absl::StrAppend(&text_, std::bit_cast<uint64_t>(value), "\n");
    } else if constexpr (std::is_same_v<T, std::string>) {
      absl::StrAppend(&text_, value.size(), ":", value, "\n");
    } else if constexpr (std::is_arithmetic_v<T>) {
      absl::StrAppend(&text_, value, "\n");
    } else {
      absl::StrAppend(&text_, value.size(), "[");
      for (auto item : value) Field("", item, "");
    }
  }
  template <class E>
  void Choice(const char*, E& value, const std::vector<std::pair<const char*, E>>&, const char*) {
    absl::StrAppend(&text_, static_cast<int>(value), "\n");
  }
  template <class S>
  void Section(const char*, S& section, const char*) {
    section.Visit(*this);
  }
  template <class T>
  void Late(const char* key, T& value, const T&, const char* doc) {
    Field(key, value, doc);
  }
  template <class S>
  void LateSection(const char* key, S& section, bool, const char* doc) {
    Section(key, section, doc);
  }

  static std::string Of(UnitConfig config) {
    ValueText values;
    config.Visit(values);
    return std::move(values.text_);
  }

 private:
  std::string text_;
};

}  // namespace

bool NamesFiles(const UnitConfig& config) {
  return !config.libero_tasks.empty() || IsLiberosOwn(config.suite) ||
         NamesFixtureTable(config.libero_fixtures);
}

UnitConfig WithPlayedFiles(UnitConfig config, const nlohmann::json& provenance) {
  for (const auto& [key, value] : {std::pair{kLiberoTasksSha256, &config.libero_tasks},
                                   std::pair{kLiberoFixturesSha256, &config.libero_fixtures}}) {
    const std::string played = TextAt(provenance, key);
    if (!played.empty()) *value = absl::StrCat(kPlayed, played);
  }
  return config;
}

UnitConfig PresentFiles::Of(UnitConfig config) {
  const auto once = [&](std::string& value, std::string (*hash)(const std::string&)) {
    const auto [known, fresh] = known_.try_emplace(value);
    if (fresh) known->second = hash(value);
    value = known->second;
  };
  if (!config.libero_tasks.empty()) {
    once(config.libero_tasks, TaskFolderHash);
  } else {
    config.libero_tasks = LiberosOwnFolder(config.libero_root, config.suite);
    if (!config.libero_tasks.empty()) once(config.libero_tasks, OwnTasksHash);
  }
  once(config.libero_fixtures, FileOrWord);
  return config;
}

FlatOptions FlatOptionsOf(const std::string& yaml) {
  FlatOptions options;
  Flatten(YAML::Load(yaml), "", options);
  return options;
}

std::string FirstDifference(const FlatOptions& a, const std::string& in_a, const FlatOptions& b,
                            const std::string& in_b) {
  std::set<std::string> keys;
  for (const FlatOptions* options : {&a, &b})
    for (const auto& [key, value] : *options) keys.insert(key);
  const auto value_of = [](const FlatOptions& options, const std::string& key) {
    const auto found = options.find(key);
    return found == options.end() ? "its default" : found->second;
  };
  for (const std::string& key : keys) {
    const std::string of_a = value_of(a, key), of_b = value_of(b, key);
    // Versions up to 0.2 did not note what LIBERO's own tasks were.
    if (key == "libero_tasks" && !(a.contains(key) && b.contains(key))) continue;
    if (of_a != of_b)
      return absl::StrCat(key, " is ", of_a, " in ", in_a, ", and ", of_b, " in ", in_b);
  }
  return "";
}

FlatOptions ProtocolOf(const UnitConfig& unit) {
  FlatOptions options = FlatOptionsOf(DumpConfig(ProtocolUnit(unit)));
  std::erase_if(options, [](const auto& option) {
    const std::string& key = option.first;
    return key == "severity" || key == "seed" || key == "suite" || key == "videos" ||
           absl::StartsWith(key, "method.");
  });
  return options;
}

std::string ScenarioHash(const UnitConfig& config) {
  if (!ArmTitle(config.scenario).empty()) return "";
  const absl::StatusOr<Scenario> scenario = MakeScenario(config.scenario, config.severity);
  // Of another arm than the Panda, or gone.
  if (!scenario.ok()) return Sha256OfFile(config.scenario).value_or("");
  std::string text =
      absl::StrCat(scenario->friction_on, scenario->gravity_on, scenario->backlash_on,
                   scenario->compliance_on, static_cast<int>(scenario->profile));
  const auto add = [&text](std::initializer_list<double> values) {
    for (const double value : values) absl::StrAppendFormat(&text, " %.17g", value);
    text += ';';
  };
  for (const JointErrorParameters& p : scenario->nominal)
    add({p.Fc, p.Fs, p.vs, p.sigma_v, p.B, p.M_eff, p.D, p.K, p.beta});
  for (const auto* factors : {&scenario->start, &scenario->end}) {
    for (const SeverityFactors& f : *factors)
      add({f.friction, f.gravity, f.backlash, f.compliance});
  }
  for (const ScenarioEffect& effect : scenario->effects) {
    absl::StrAppend(&text, effect.type, " ", effect.joint, " ", effect.coupled);
    for (const double value : effect.values) add({value});
  }
  return Sha256Hex(text);
}

void PlayedAlike::Add(const UnitConfig& config, const std::string& place) {
  Look(config, place, true);
}

void PlayedAlike::Compare(const UnitConfig& config, const std::string& place) {
  Look(config, place, false);
}

void PlayedAlike::Look(const UnitConfig& config, const std::string& place, bool add) {
  const bool file = IsScenarioFile(config.scenario);
  UnitConfig whole = config;
  whole.seed = 0, whole.videos = 0;
  if (!file) whole.scenario.clear(), whole.severity = 0;
  if (!seen_.insert(ValueText::Of(std::move(whole))).second) return;
  std::map<std::string, UnitConfig> parts = {
      {"suite " + config.suite, SuiteUnit(config)},
      {"method " + config.method->method, MethodUnit(config)},
      {"policy " + PolicyLabel(config.policy), RemoteUnit(config)}};
  if (file) {
    parts.emplace(
        absl::StrCat("scenario ", ScenarioLabel(config.scenario), " at L", config.severity),
        ScenarioUnit(config));
  }
  for (const auto& [what, part] : parts) {
    const auto first = first_.find(what);
    if (first == first_.end()) {
      if (add) first_.emplace(what, First{part, place});
      continue;
    }
    const std::string difference =
        FirstDifference(FlatOptionsOf(DumpConfig(first->second.config)), first->second.place,
                        FlatOptionsOf(DumpConfig(part)), place);
    if (!difference.empty() && unlike_.insert(what).second)
      complaints_.push_back(absl::StrCat(what, ": ", difference));
    if (first->second.config.libero_tasks.empty())
      first->second.config.libero_tasks = part.libero_tasks;
  }
}

std::vector<std::string> UnlikeUnits(const RunData& run) {
  PlayedAlike alike;
  for (const UnitResult& unit : run.units) alike.Add(unit.config, unit.id);
  return alike.complaints();
}

std::string LiberoFilesNote(const RunData& run) {
  std::map<std::string, int> others;  // units by what they say
  for (const UnitResult& unit : run.units) {
    const std::string said = TextAt(unit.provenance, kLiberoFiles);
    if (!said.empty() && said != kLiberoFilesPublished) ++others[said];
  }
  std::vector<std::string> notes;
  for (const auto& [said, units] : others)
    notes.push_back(absl::StrCat(units, units == 1 ? " unit: " : " units: ", said));
  return notes.empty() ? ""
                       : absl::StrCat("Not played on LIBERO as it was published. ",
                                      absl::StrJoin(notes, "; "), ".");
}

std::string UnlikeUnitsNote(const RunData& run) {
  const std::vector<std::string> unlike = UnlikeUnits(run);
  if (unlike.empty()) return "";
  return absl::StrCat(
      "These units were not played alike, so that their rows and differences say "
      "nothing: ",
      absl::StrJoin(unlike, "; "), ".");
}

}  // namespace robostress
