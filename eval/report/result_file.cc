#include "eval/report/result_file.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/plain_line.h"
#include "common/status_macros.h"
#include "eval/report/result_checks.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

constexpr uint64_t kMostBytes = 64 << 20;
constexpr int kMostEpisodes = 100'000'000;
constexpr size_t kMostEntries = 200'000, kMostText = 4096;

// --- writing ------------------------------------------------------------------------------------

ordered_json IntervalOrNull(const std::optional<Interval>& interval) {
  if (!interval) return nullptr;
  return {interval->low, interval->high};
}

ordered_json TextOrNull(const std::string& text) {
  return text.empty() ? ordered_json(nullptr) : ordered_json(text);
}

ordered_json LevelOrNull(int severity) {
  return severity == 0 ? ordered_json(nullptr) : ordered_json(severity);
}

// Interval methods of a difference and of a mean, by Clustering.
const std::vector<std::string> kDifferenceMethods = {"paired_cluster_bootstrap",
                                                     "paired_cluster_bootstrap_by_task"};
const std::vector<std::string> kMeanMethods = {"cluster_bootstrap", "cluster_bootstrap_by_task"};

const std::string& MethodOf(Clustering clustering, const std::vector<std::string>& methods) {
  return methods[clustering == Clustering::kTask];
}

Clustering ClusteringOf(const std::string& method, const std::vector<std::string>& methods) {
  return method == methods[1] ? Clustering::kTask : Clustering::kInitialState;
}

ordered_json DifferenceJson(const ResultDifference& d) {
  return {{"pairs", d.pairs},
          {"plus", d.plus},
          {"minus", d.minus},
          {"clusters", d.clusters},
          {"difference", d.difference},
          {"interval", IntervalOrNull(d.interval)},
          {"interval_method", MethodOf(d.clustering, kDifferenceMethods)},
          {"p", d.p},
          {"p_method", d.p_exact ? "cluster_sign_flip_exact" : "cluster_sign_flip_drawn"},
          {"p_corrected", d.p_corrected ? ordered_json(*d.p_corrected) : ordered_json(nullptr)},
          {"correction", "holm"},
          {"design_effect", d.design_effect}};
}

ordered_json CellJson(const ResultCell& cell) {
  ordered_json out = {{"policy", cell.policy}, {"suite", cell.suite}};
  if (cell.is_mean()) {
    out["scenarios"] = cell.scenarios;
  } else {
    out["scenario"] = cell.scenario;
  }
  out["severity"] = LevelOrNull(cell.severity);
  out["method"] = cell.method;
  out["n"] = cell.counts.n;
  if (!cell.is_mean()) out["successes"] = cell.counts.successes;
  out["rate"] = cell.rate;
  out["interval"] = IntervalOrNull(cell.interval);
  out["interval_method"] =
      cell.is_mean() ? MethodOf(cell.clustering, kMeanMethods) : "wilson_effective_n";
  out["clusters"] = cell.counts.clusters;
  if (!cell.is_mean()) out["design_effect"] = cell.counts.design_effect;
  out["seeds"] = cell.seeds;
  out["versus_base"] = cell.versus_base ? DifferenceJson(*cell.versus_base) : ordered_json(nullptr);
  ordered_json controls = ordered_json::object();
  for (const auto& [control, difference] : cell.versus_control)
    controls[control] = DifferenceJson(difference);
  out["versus_controls"] = controls;
  return out;
}

ordered_json PolicyJson(const ResultPolicy& policy) {
  ordered_json server = nullptr;
  if (policy.server) {
    server = {{"dialect", policy.server->dialect},
              {"urls", policy.server->urls},
              {"metadata_sha256", policy.server->metadata_sha256},
              {"metadata_changed", policy.server->metadata_changed},
              {"reconnections", policy.server->reconnections}};
  }
  return {{"label", policy.label},
          {"model_hash", TextOrNull(policy.model_hash)},
          {"noise_paired", policy.noise_paired},
          {"server", server},
          {"options", policy.options}};
}

// --- reading ------------------------------------------------------------------------------------

// The fields of one object, and what is wrong with them.
class Fields {
 public:
  Fields(const json& object, std::string path, std::vector<std::string>& complaints)
      : object_(object), path_(std::move(path)), complaints_(complaints) {
    if (!object_.is_object()) Complain("", object_, "an object");
  }

  void Text(const char* key, std::string& value, size_t most = kMostText) {
    if (const json* field = Take(key)) SetText(key, *field, value, most);
  }
  void TextOrNull(const char* key, std::string& value) {
    const json* field = Take(key);
    if (field != nullptr && !field->is_null()) SetText(key, *field, value, kMostText);
  }
  void Word(const char* key, std::string& value, const std::vector<std::string>& known) {
    Text(key, value);
    if (std::find(known.begin(), known.end(), value) == known.end() && object_.contains(key))
      Complain(key, object_[key], absl::StrCat("one of ", absl::StrJoin(known, ", ")));
  }
  void Flag(const char* key, bool& value) {
    const json* field = Take(key);
    if (field == nullptr) return;
    if (!field->is_boolean()) return Complain(key, *field, "true or false");
    value = field->get<bool>();
  }
  void Whole(const char* key, int& value, int low, int high) {
    if (const json* field = Take(key)) SetWhole(key, *field, value, low, high);
  }
  // Null: 0.
  void Level(int& value) {
    const json* field = Take("severity");
    if (field != nullptr && !field->is_null()) SetWhole("severity", *field, value, 1, 5);
  }
  void Number(const char* key, double& value, double low, double high) {
    if (const json* field = Take(key)) SetNumber(key, *field, value, low, high);
  }
  void NumberOrNull(const char* key, std::optional<double>& value, double low, double high) {
    const json* field = Take(key);
    if (field == nullptr || field->is_null()) return;
    double number = low;
    SetNumber(key, *field, number, low, high);
    value = number;
  }
  void IntervalOrNull(const char* key, std::optional<Interval>& value, double low, double high) {
    const json* field = Take(key);
    if (field == nullptr || field->is_null()) return;
    if (!field->is_array() || field->size() != 2 || !(*field)[0].is_number() ||
        !(*field)[1].is_number() || !((*field)[0].get<double>() >= low) ||
        !((*field)[0].get<double>() <= (*field)[1].get<double>()) ||
        !((*field)[1].get<double>() <= high)) {
      return Complain(key, *field,
                      absl::StrCat("null or two numbers in order, ", low, " to ", high));
    }
    value = Interval{(*field)[0].get<double>(), (*field)[1].get<double>()};
  }
  void Texts(const char* key, std::vector<std::string>& values) {
    ForEach(key, [&](const json& item, const std::string& place) {
      values.emplace_back();
      SetText(place, item, values.back(), kMostText);
    });
  }
  void Seeds(const char* key, std::vector<int64_t>& values) {
    ForEach(key, [&](const json& item, const std::string& place) {
      if (!item.is_number_integer() ||
          (item.is_number_unsigned() && item.get<uint64_t>() > static_cast<uint64_t>(INT64_MAX)))
        return Complain(place, item, "an integer of 64 bits");
      values.push_back(item.get<int64_t>());
    });
  }
  void TextMap(const char* key, std::map<std::string, std::string>& values) {
    const json* field = Take(key);
    if (field == nullptr) return;
    if (!field->is_object()) return Complain(key, *field, "an object of texts");
    if (field->size() > 1000) return Complain(key, field->size(), "at most 1000 entries");
    for (const auto& [name, item] : field->items()) {
      std::string checked;
      SetText(absl::StrCat(key, " (a key)"), name, checked, kMostText);
      SetText(absl::StrCat(key, ".", Shown(name)), item, values[name], kMostText);
    }
  }
  void Objects(const char* key, const std::function<void(Fields&)>& read) {
    ForEach(key, [&](const json& item, const std::string& place) {
      Fields fields(item, absl::StrCat(path_, place, "."), complaints_);
      read(fields);
      fields.Finish();
    });
  }
  // Null: not read.
  void ObjectOrNull(const char* key, const std::function<void(Fields&)>& read) {
    const json* field = Take(key);
    if (field == nullptr || field->is_null()) return;
    Fields fields(*field, absl::StrCat(path_, key, "."), complaints_);
    read(fields);
    fields.Finish();
  }
  void ObjectMap(const char* key, const std::function<void(const std::string&, Fields&)>& read) {
    const json* field = Take(key);
    if (field == nullptr) return;
    if (!field->is_object()) return Complain(key, *field, "an object");
    for (const auto& [name, item] : field->items()) {
      std::string checked;
      SetText(absl::StrCat(key, " (a key)"), name, checked, kMostText);
      Fields fields(item, absl::StrCat(path_, key, ".", Shown(name), "."), complaints_);
      read(name, fields);
      fields.Finish();
    }
  }
  void Check(bool holds, const std::string& complaint) {
    if (!holds && object_.is_object()) Say(absl::StrCat(Here(), complaint));
  }
  // Complains of keys that nobody took.
  void Finish() {
    if (!object_.is_object()) return;
    for (const auto& [key, value] : object_.items()) {
      if (known_.count(key) == 0)
        Say(absl::StrCat("field ", path_, Shown(key), " is unknown in version ",
                         kResultSchemaVersion, " of the schema; remove it"));
    }
  }

 private:
  static std::string Shown(const json& value) {
    std::string text = value.is_string()
                           ? value.get<std::string>()
                           : value.dump(-1, ' ', true, json::error_handler_t::replace);
    text = PlainLine(text);
    return text.size() > 60 ? text.substr(0, 60) + "..." : text;
  }
  std::string Here() const {
    return path_.empty() ? "" : absl::StrCat(path_.substr(0, path_.size() - 1), ": ");
  }
  void Say(std::string text) {
    if (complaints_.size() <= kMostContradictions) complaints_.push_back(std::move(text));
  }
  void Complain(const std::string& key, const json& value, const std::string& wanted) {
    Say(absl::StrCat("field ", path_, key, " is ", Shown(value), ", must be ", wanted));
  }
  const json* Take(const char* key) {
    known_.insert(key);
    if (!object_.is_object()) return nullptr;
    const auto field = object_.find(key);
    if (field != object_.end()) return &*field;
    Say(absl::StrCat("field ", path_, key, " is missing"));
    return nullptr;
  }
  void SetText(const std::string& key, const json& field, std::string& value, size_t most) {
    const std::string* text = field.get_ptr<const std::string*>();
    const bool plain =
        text != nullptr && !text->empty() && text->size() <= most && IsPlainLine(*text);
    if (!plain)
      return Complain(key, field,
                      absl::StrCat("text of 1 to ", most,
                                   " bytes without control characters or marks that turn the "
                                   "direction of writing"));
    value = *text;
  }
  void SetWhole(const char* key, const json& field, int& value, int low, int high) {
    const bool fits = field.is_number_unsigned()
                          ? field.get<uint64_t>() <= static_cast<uint64_t>(high) &&
                                static_cast<int>(field.get<uint64_t>()) >= low
                          : field.is_number_integer() && field.get<int64_t>() >= low &&
                                field.get<int64_t>() <= high;
    if (!fits) return Complain(key, field, absl::StrCat("a whole number, ", low, " to ", high));
    value = field.get<int>();
  }
  void SetNumber(const char* key, const json& field, double& value, double low, double high) {
    if (!field.is_number() || !(field.get<double>() >= low) || !(field.get<double>() <= high))
      return Complain(key, field, absl::StrCat("a number, ", low, " to ", high));
    value = field.get<double>();
  }
  void ForEach(const char* key, const std::function<void(const json&, const std::string&)>& use) {
    const json* field = Take(key);
    if (field == nullptr) return;
    if (!field->is_array()) return Complain(key, *field, "a list");
    if (field->size() > kMostEntries)
      return Complain(absl::StrCat(key, " (entries)"), field->size(),
                      absl::StrCat("at most ", kMostEntries));
    for (size_t i = 0; i < field->size(); ++i) use((*field)[i], absl::StrCat(key, "[", i, "]"));
  }

  const json& object_;
  const std::string path_;
  std::vector<std::string>& complaints_;
  std::set<std::string> known_;
};

void ReadDifference(Fields& fields, const ResultCell& cell, ResultDifference& d) {
  fields.Whole("pairs", d.pairs, 1, cell.counts.n);
  fields.Whole("plus", d.plus, 0, d.pairs);
  fields.Whole("minus", d.minus, 0, d.pairs);
  fields.Whole("clusters", d.clusters, 1, d.pairs);
  fields.Number("difference", d.difference, -1, 1);
  fields.IntervalOrNull("interval", d.interval, -1, 1);
  std::string method, p_method, correction;
  fields.Word("interval_method", method, kDifferenceMethods);
  d.clustering = ClusteringOf(method, kDifferenceMethods);
  fields.Number("p", d.p, 0, 1);
  fields.Word("p_method", p_method, {"cluster_sign_flip_exact", "cluster_sign_flip_drawn"});
  d.p_exact = p_method == "cluster_sign_flip_exact";
  fields.NumberOrNull("p_corrected", d.p_corrected, 0, 1);
  fields.Word("correction", correction, {"holm"});
  fields.Number("design_effect", d.design_effect, 0, kMostEpisodes);
  fields.Check(d.plus + d.minus <= d.pairs, absl::StrCat("plus ", d.plus, " and minus ", d.minus,
                                                         " are more than ", d.pairs, " pairs"));
  const double counted = d.pairs == 0 ? 0 : static_cast<double>(d.plus - d.minus) / d.pairs;
  fields.Check(
      cell.is_mean() || std::abs(d.difference - counted) < kResultRounding,
      absl::StrCat("difference is ", d.difference, ", plus, minus and pairs say ", counted));
  fields.Check(!d.p_corrected || *d.p_corrected >= d.p - kResultRounding,
               absl::StrCat("p_corrected is ", d.p_corrected.value_or(0), ", below p ", d.p));
}

void ReadCell(Fields& fields, bool mean, ResultCell& cell) {
  fields.Text("policy", cell.policy);
  fields.Text("suite", cell.suite);
  if (mean) {
    fields.Texts("scenarios", cell.scenarios);
    fields.Check(!cell.scenarios.empty(), "scenarios is empty");
  } else {
    fields.Text("scenario", cell.scenario);
  }
  fields.Level(cell.severity);
  fields.Text("method", cell.method);
  ClusteredRate& counts = cell.counts;
  fields.Whole("n", counts.n, 1, kMostEpisodes);
  if (!mean) fields.Whole("successes", counts.successes, 0, counts.n);
  fields.Number("rate", cell.rate, 0, 1);
  fields.IntervalOrNull("interval", cell.interval, 0, 1);
  std::string method;
  fields.Word("interval_method", method,
              mean ? kMeanMethods : std::vector<std::string>{"wilson_effective_n"});
  if (mean) cell.clustering = ClusteringOf(method, kMeanMethods);
  fields.Whole("clusters", counts.clusters, 1, counts.n);
  if (!mean) fields.Number("design_effect", counts.design_effect, 1, counts.n);
  fields.Seeds("seeds", cell.seeds);
  fields.ObjectOrNull("versus_base", [&](Fields& of_base) {
    ReadDifference(of_base, cell, cell.versus_base.emplace());
  });
  fields.ObjectMap("versus_controls", [&](const std::string& control, Fields& of_control) {
    ReadDifference(of_control, cell, cell.versus_control[control]);
  });
  if (mean && cell.interval) {
    fields.Check(cell.rate >= cell.interval->low - kResultRounding &&
                     cell.rate <= cell.interval->high + kResultRounding,
                 absl::StrCat("rate is ", cell.rate, ", outside its interval [", cell.interval->low,
                              ", ", cell.interval->high, "]"));
  }
  if (mean || counts.n == 0) return;
  fields.Check(std::abs(cell.rate - counts.rate()) < kResultRounding,
               absl::StrCat("rate is ", cell.rate, ", successes of n say ", counts.rate()));
  const Interval wanted = RateInterval(counts);
  fields.Check(cell.interval && std::abs(cell.interval->low - wanted.low) < kResultRounding &&
                   std::abs(cell.interval->high - wanted.high) < kResultRounding,
               absl::StrCat("interval is not that of n, successes and design_effect, [", wanted.low,
                            ", ", wanted.high, "]"));
}

void ReadServer(Fields& fields, ResultServer& server) {
  fields.Text("dialect", server.dialect);
  fields.Texts("urls", server.urls);
  fields.Texts("metadata_sha256", server.metadata_sha256);
  fields.Flag("metadata_changed", server.metadata_changed);
  fields.Whole("reconnections", server.reconnections, 0, kMostEpisodes);
}

void ReadAll(Fields& fields, ResultFile& file) {
  fields.ObjectOrNull("versions", [&](Fields& versions) {
    versions.Texts("robostress", file.robostress);
    versions.TextOrNull("mujoco", file.mujoco);
  });
  fields.Whole("bootstrap_replicates", file.bootstrap_replicates, 1, 1000000);
  double confidence = 0;
  fields.Number("confidence", confidence, 0.95, 0.95);
  fields.Objects("policies", [&](Fields& f) {
    ResultPolicy& policy = file.policies.emplace_back();
    f.Text("label", policy.label);
    f.TextOrNull("model_hash", policy.model_hash);
    f.Flag("noise_paired", policy.noise_paired);
    f.ObjectOrNull("server", [&](Fields& s) { ReadServer(s, policy.server.emplace()); });
    f.TextMap("options", policy.options);
  });
  fields.Objects("scenarios", [&](Fields& f) {
    ResultScenario& scenario = file.scenarios.emplace_back();
    f.Text("name", scenario.name);
    f.Level(scenario.severity);
    f.TextOrNull("sha256", scenario.sha256);
  });
  fields.Objects("methods", [&](Fields& f) {
    ResultMethod& method = file.methods.emplace_back();
    f.Text("name", method.name);
    f.Word("role", method.role, {"base", "control", "method"});
    f.Text("sha256", method.sha256);
  });
  fields.Objects("protocols", [&](Fields& f) {
    ResultProtocol& protocol = file.protocols.emplace_back();
    f.Text("suite", protocol.suite);
    f.TextMap("options", protocol.options);
  });
  fields.Objects("results", [&](Fields& f) { ReadCell(f, false, file.results.emplace_back()); });
  fields.Objects("means", [&](Fields& f) { ReadCell(f, true, file.means.emplace_back()); });
  fields.Texts("notes", file.notes);
  fields.Check(!file.results.empty(), "results is empty");
}

}  // namespace

std::string WriteResultFile(const ResultFile& file) {
  ordered_json policies = json::array(), scenarios = json::array(), methods = json::array(),
               protocols = json::array(), results = json::array(), means = json::array();
  for (const ResultPolicy& policy : file.policies) policies.push_back(PolicyJson(policy));
  for (const ResultScenario& s : file.scenarios) {
    scenarios.push_back(ordered_json{
        {"name", s.name}, {"severity", LevelOrNull(s.severity)}, {"sha256", TextOrNull(s.sha256)}});
  }
  for (const ResultMethod& m : file.methods)
    methods.push_back(ordered_json{{"name", m.name}, {"role", m.role}, {"sha256", m.sha256}});
  for (const ResultProtocol& p : file.protocols)
    protocols.push_back(ordered_json{{"suite", p.suite}, {"options", p.options}});
  for (const ResultCell& cell : file.results) results.push_back(CellJson(cell));
  for (const ResultCell& cell : file.means) means.push_back(CellJson(cell));
  const ordered_json all = {
      {"schema", kResultSchema},
      {"schema_version", kResultSchemaVersion},
      {"versions", {{"robostress", file.robostress}, {"mujoco", TextOrNull(file.mujoco)}}},
      {"bootstrap_replicates", file.bootstrap_replicates},
      {"confidence", 0.95},
      {"policies", policies},
      {"scenarios", scenarios},
      {"methods", methods},
      {"protocols", protocols},
      {"results", results},
      {"means", means},
      {"notes", file.notes}};
  return all.dump(2, ' ', false, json::error_handler_t::replace) + "\n";
}

absl::StatusOr<ResultFile> ParseResultFile(const std::string& source, const std::string& text) {
  const absl::StatusOr<json> parsed = ParseJsonObject(text);
  if (!parsed.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(source, " cannot be read: ", parsed.status().message(),
                     "; give a file that `robostress report RUN --export FILE` wrote"));
  }
  std::vector<std::string> complaints;
  Fields fields(*parsed, "", complaints);
  std::string schema;
  int version = 0;
  fields.Text("schema", schema);
  fields.Whole("schema_version", version, 0, 1'000'000);
  if (complaints.empty() && (schema != kResultSchema || version != kResultSchemaVersion)) {
    return absl::InvalidArgumentError(absl::StrCat(
        source, ": schema is ", schema, " version ", version, ", this program reads ",
        kResultSchema, " version ", kResultSchemaVersion,
        version > kResultSchemaVersion ? "; use a newer RoboStress" : "; export it again"));
  }
  ResultFile file;
  if (complaints.empty()) {
    ReadAll(fields, file);
    fields.Finish();
  }
  if (complaints.empty()) {
    complaints = ContradictionsOf(file);
  }
  if (complaints.empty()) return file;
  const bool more = complaints.size() > kMostContradictions;
  if (more) complaints.resize(kMostContradictions);
  return absl::InvalidArgumentError(
      absl::StrCat(source, ":\n  ", absl::StrJoin(complaints, "\n  "), more ? "\n  and more" : ""));
}

absl::StatusOr<ResultFile> ReadResultFile(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostBytes));
  return ParseResultFile(path, text);
}

}  // namespace robostress
