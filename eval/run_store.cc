#include "eval/run_store.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/status_macros.h"
#include "common/suites.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Columns of the table, in this order; other fields of the records follow in alphabetical order.
const std::vector<std::string>& LeadingColumns() {
  static const auto& columns = *new std::vector<std::string>{
      "suite",   "scenario",      "severity", "policy", "method", "seed",   "task",
      "episode", "initial_state", "success",  "steps",  "chunks", "updates"};
  return columns;
}

std::vector<std::string> Lines(const std::string& text) {
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  lines.erase(std::remove(lines.begin(), lines.end(), ""), lines.end());
  return lines;
}

template <class Names>
int IndexOf(const Names& names, const std::string& name) {
  return static_cast<int>(std::find(names.begin(), names.end(), name) - names.begin());
}

auto CanonicalKey(const UnitConfig& config) {
  static const auto& suites = *new std::vector<std::string>([] {
    std::vector<std::string> names;
    for (const SuiteInfo& suite : AllSuites()) names.push_back(suite.name);
    return names;
  }());
  static const auto& scenarios = *new std::vector<std::string>(ScenarioNames());
  static const auto& methods = *new std::vector<std::string>(MethodNames());
  return std::tuple(IndexOf(suites, config.suite), IndexOf(scenarios, config.scenario),
                    ScenarioLabel(config.scenario), config.severity, config.policy, IndexOf(methods, config.method.method),
                    config.seed);
}

std::string CsvCell(const json& value) {
  if (value.is_null()) return "";
  if (value.is_boolean()) return value.get<bool>() ? "1" : "0";
  if (!value.is_string()) return value.dump();
  std::string text = value.get<std::string>();
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) absl::StrAppend(&quoted, c == '"' ? "\"\"" : std::string(1, c));
  return quoted + "\"";
}

absl::StatusOr<std::vector<json>> ReadJsonLines(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  std::vector<json> records;
  for (const std::string& line : Lines(text)) {
    json record = json::parse(line, nullptr, false);
    if (!record.is_object()) {
      return absl::DataLossError(absl::StrCat(file, ":", records.size() + 1,
                                              ": not a JSON object: '", line.substr(0, 80), "'"));
    }
    records.push_back(std::move(record));
  }
  return records;
}

// Reads fields of one record and remembers the first that is wrong.
class RecordReader {
 public:
  RecordReader(const std::string& source, const json& record) : source_(source), record_(record) {}

  int Int(const char* key) {
    const auto field = record_.find(key);
    if (field == record_.end() || !field->is_number_integer()) return Fail(key, "an integer"), 0;
    return field->get<int>();
  }
  bool Bool(const char* key) {
    const auto field = record_.find(key);
    if (field == record_.end() || !field->is_boolean()) return Fail(key, "true or false"), false;
    return field->get<bool>();
  }
  std::optional<double> Number(const char* key) {
    const auto field = record_.find(key);
    if (field == record_.end() || field->is_null()) return std::nullopt;
    if (!field->is_number()) return Fail(key, "a number"), std::nullopt;
    return field->get<double>();
  }
  const absl::Status& status() const { return status_; }

 private:
  void Fail(const char* key, const char* expected) {
    if (!status_.ok()) return;
    const auto field = record_.find(key);
    status_ = absl::DataLossError(absl::StrCat(
        source_, ": field ", key,
        field == record_.end() ? " is missing" : absl::StrCat(" is ", field->dump()), ", must be ",
        expected, "; the file was not written by this version's worker"));
  }
  const std::string& source_;
  const json& record_;
  absl::Status status_;
};

absl::Status CheckAgainstConfig(const std::string& file, const UnitResult& unit) {
  const size_t expected = unit.config.tasks.size() * unit.config.episodes;
  if (unit.episodes.size() != expected) {
    return absl::DataLossError(absl::StrCat(file, " has ", unit.episodes.size(),
                                            " episodes, its configuration says ", expected,
                                            "; remove the unit's folder and run the sweep again"));
  }
  std::set<std::pair<int, int>> seen;
  for (const EpisodeRow& row : unit.episodes) {
    if (!seen.insert({row.task, row.episode}).second) {
      return absl::DataLossError(
          absl::StrCat(file, ": task ", row.task, " episode ", row.episode, " is recorded twice"));
    }
  }
  return absl::OkStatus();
}

void AddTiming(const json& record, TimingSums& sums) {
  const auto seconds = [&](const char* key) {
    const auto field = record.find(key);
    return field != record.end() && field->is_number() ? field->get<double>() : 0.0;
  };
  ++sums.episodes;
  sums.wall_s += seconds("wall_s");
  sums.predict_s += seconds("predict_s");
  sums.step_s += seconds("step_s");
  sums.observe_s += seconds("observe_s");
  sums.feedback_s += seconds("feedback_s");
}

absl::StatusOr<UnitResult> LoadUnit(const fs::path& dir) {
  UnitResult unit;
  unit.id = dir.filename().string();
  RS_ASSIGN_OR_RETURN(unit.config, LoadConfig<UnitConfig>((dir / "config.yaml").string()));
  if (unit.config.tasks.empty()) {
    const SuiteInfo* suite = FindSuite(unit.config.suite);
    for (int task = 0; suite != nullptr && task < suite->num_tasks; ++task)
      unit.config.tasks.push_back(task);
  }
  const std::string file = (dir / "episodes.jsonl").string();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  for (const std::string& line : Lines(text)) {
    RS_ASSIGN_OR_RETURN(EpisodeRow row,
                        ParseEpisode(absl::StrCat(file, ":", unit.episodes.size() + 1), line));
    unit.episodes.push_back(std::move(row));
  }
  RS_RETURN_IF_ERROR(CheckAgainstConfig(file, unit));
  if (const auto text = ReadFile((dir / "provenance.json").string()); text.ok()) {
    unit.provenance = json::parse(*text, nullptr, false);
  }
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(dir / "videos", none)) {
    if (entry.path().extension() == ".webp") unit.videos.push_back(entry.path().string());
  }
  std::sort(unit.videos.begin(), unit.videos.end());
  if (const auto timings = ReadJsonLines((dir / "timing.jsonl").string()); timings.ok()) {
    for (const json& record : *timings) AddTiming(record, unit.timing);
  }
  return unit;
}

}  // namespace

absl::StatusOr<EpisodeRow> ParseEpisode(const std::string& source, const std::string& line) {
  EpisodeRow row;
  row.fields = json::parse(line, nullptr, false);
  if (!row.fields.is_object()) {
    return absl::DataLossError(
        absl::StrCat(source, ": not a JSON object: '", line.substr(0, 80), "'"));
  }
  RecordReader reader(source, row.fields);
  row.task = reader.Int("task");
  row.episode = reader.Int("episode");
  row.initial_state = reader.Int("initial_state");
  row.success = reader.Bool("success");
  row.steps = reader.Int("steps");
  row.chunks = reader.Int("chunks");
  row.updates = reader.Int("updates");
  row.residual = reader.Number("residual");
  row.eta_sq = reader.Number("eta_sq");
  row.a_sq = reader.Number("a_sq");
  row.intent = reader.Number("intent");
  row.intent_eta_sq = reader.Number("intent_eta_sq");
  row.intent_a_sq = reader.Number("intent_a_sq");
  row.residual_tracking = reader.Number("residual_tracking");
  row.lag_residual = reader.Number("lag_residual");
  row.mean_abs_action = reader.Number("mean_abs_action");
  row.clipped_share = reader.Number("clipped_share");
  row.adapter_distance = reader.Number("adapter_distance");
  RS_RETURN_IF_ERROR(reader.status());
  return row;
}

absl::StatusOr<RunData> LoadRun(const std::string& dir) {
  RunData run;
  run.dir = dir;
  const fs::path units = fs::path(dir) / "units";
  std::error_code error;
  if (!fs::is_directory(units, error)) {
    return absl::NotFoundError(absl::StrCat(
        dir, " is not a run directory: it has no folder units/. Give the --out of a sweep"));
  }
  std::vector<fs::path> folders;
  for (const auto& entry : fs::directory_iterator(units, error)) folders.push_back(entry.path());
  std::sort(folders.begin(), folders.end());
  for (const fs::path& folder : folders) {
    if (!fs::exists(folder / "DONE")) {
      run.unfinished.push_back(folder.filename().string());
      continue;
    }
    RS_ASSIGN_OR_RETURN(UnitResult unit, LoadUnit(folder));
    run.units.push_back(std::move(unit));
  }
  if (run.units.empty()) {
    return absl::NotFoundError(
        absl::StrCat(dir, " has no finished unit; run the sweep that made it again, it continues"));
  }
  std::stable_sort(run.units.begin(), run.units.end(),
                   [](const UnitResult& a, const UnitResult& b) {
                     return CanonicalKey(a.config) < CanonicalKey(b.config);
                   });
  if (const auto text = ReadFile(dir + "/environment.json"); text.ok())
    run.environment = json::parse(*text, nullptr, false);
  if (const auto launches = ReadJsonLines(dir + "/launches.jsonl"); launches.ok()) {
    for (const json& launch : *launches) run.sweep_wall_s += launch.value("wall_s", 0.0);
  }
  return run;
}

std::string EpisodeTableCsv(const RunData& run) {
  std::vector<std::string> columns = LeadingColumns();
  std::set<std::string> others;
  for (const UnitResult& unit : run.units) {
    for (const EpisodeRow& row : unit.episodes) {
      for (const auto& [name, value] : row.fields.items()) others.insert(name);
    }
  }
  for (const std::string& name : columns) others.erase(name);
  columns.insert(columns.end(), others.begin(), others.end());
  std::string csv = absl::StrJoin(columns, ",") + "\n";
  for (const UnitResult& unit : run.units) {
    for (const EpisodeRow& row : unit.episodes) {
      std::vector<std::string> cells;
      for (const std::string& name : columns)
        cells.push_back(row.fields.contains(name) ? CsvCell(row.fields[name]) : "");
      absl::StrAppend(&csv, absl::StrJoin(cells, ","), "\n");
    }
  }
  return csv;
}

std::string UnitTimingCsv(const RunData& run) {
  std::string csv = "unit,episodes,wall_s,predict_s,step_s,observe_s,feedback_s\n";
  for (const UnitResult& unit : run.units) {
    const TimingSums& t = unit.timing;
    absl::StrAppend(
        &csv, absl::StrFormat("%s,%d,%.3f,%.3f,%.3f,%.3f,%.3f\n", unit.id, t.episodes, t.wall_s,
                              t.predict_s, t.step_s, t.observe_s, t.feedback_s));
  }
  return csv;
}

}  // namespace robostress
