#include "calibration/data/client_recordings.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/csv_table.h"
#include "common/robot_description.h"
#include "common/statistics.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "robot_client/emulator/piper_mjcf.h"

namespace robostress::calibration {
namespace {

constexpr char kTicks[] = "ticks.csv";
constexpr char kSamples[] = "samples.csv";
constexpr double kShortest_s = 1;  // of an episode
constexpr double kGap = 4;         // periods between two samples at which another one begins

// A table of a run; the error where there is none says what may have become of it.
absl::StatusOr<CsvTable> ReadRunTable(const std::string& run, const std::string& name) {
  const std::string file = (std::filesystem::path(run) / name).string();
  if (std::filesystem::exists(file)) return CsvTable::Read(file);
  const bool unfinished = std::filesystem::exists(file + ".partial");
  return absl::NotFoundError(absl::StrCat(
      file, ": is not there",
      unfinished ? "; the recording was cut off: rename the file ending in .partial without it"
      : name == kSamples ? "; the run is older than this table, or of an arm that is not there"
                         : ""));
}

struct Interval {
  double begin = 0, end = 0;  // [s]
};

// When the arm followed a policy, or a way of the client's own, or held.
absl::StatusOr<std::vector<Interval>> Driven(const CsvTable& ticks) {
  RS_ASSIGN_OR_RETURN(const std::vector<double> t, ticks.Numbers("t"));
  RS_ASSIGN_OR_RETURN(const size_t state, ticks.Column("state"));
  RS_ASSIGN_OR_RETURN(const size_t episode, ticks.Column("episode"));
  std::vector<Interval> intervals;
  absl::string_view current;  // episode; empty: not driven
  for (size_t row = 0; row < ticks.rows(); ++row) {
    const absl::string_view name = ticks.Text(row, state);
    const bool driven = name == "RUN" || name == "MOVE" || name == "HOLD";
    if (!driven) {
      current = {};
      continue;
    }
    if (current != ticks.Text(row, episode)) intervals.push_back({t[row], t[row]});
    current = ticks.Text(row, episode);
    intervals.back().end = t[row];
  }
  return intervals;
}

// What was sent, and when; empty where the table does not say. Nothing is sent to an arm without
// power: its rows have no targets.
struct Commands {
  std::vector<double> t;                    // [s]
  std::vector<std::vector<double>> target;  // [joints][rows]

  static absl::StatusOr<Commands> Read(const CsvTable& ticks, int joints) {
    Commands commands;
    if (!ticks.Has("sent_J1")) return commands;
    RS_ASSIGN_OR_RETURN(const size_t time, ticks.Column("t"));
    RS_ASSIGN_OR_RETURN(const size_t sent_us, ticks.Column("sent_us"));
    std::vector<size_t> columns;
    for (int j = 1; j <= joints; ++j) {
      RS_ASSIGN_OR_RETURN(columns.emplace_back(), ticks.Column(absl::StrCat("sent_J", j)));
    }
    commands.target.resize(columns.size());
    for (size_t row = 0; row < ticks.rows(); ++row) {
      if (ticks.Text(row, columns[0]).empty()) continue;
      RS_ASSIGN_OR_RETURN(const double began, ticks.Number(row, time));
      RS_ASSIGN_OR_RETURN(const double later_us, ticks.Number(row, sent_us));
      commands.t.push_back(began + 1e-6 * later_us);
      for (size_t j = 0; j < columns.size(); ++j) {
        RS_ASSIGN_OR_RETURN(commands.target[j].emplace_back(), ticks.Number(row, columns[j]));
      }
    }
    return commands;
  }
  // In force at `time`; the first where none is yet.
  size_t At(double time) const {
    const auto next = std::upper_bound(t.begin(), t.end(), time);
    return next == t.begin() ? 0 : static_cast<size_t>(next - t.begin()) - 1;
  }
};

// All samples of a run by column.
struct Samples {
  std::vector<double> t, sequence;
  std::vector<std::vector<double>> q, dq, tau;  // [joints][rows]

  static absl::StatusOr<Samples> Read(const CsvTable& table) {
    Samples samples;
    int joints = 1;
    while (table.Has(absl::StrCat("q_J", joints + 1))) ++joints;
    RS_ASSIGN_OR_RETURN(samples.t, table.Numbers("t"));
    RS_ASSIGN_OR_RETURN(samples.sequence, table.Numbers("sequence"));
    for (auto [group, name] :
         {std::pair(&samples.q, "q"), {&samples.dq, "dq"}, {&samples.tau, "tau"}}) {
      for (int j = 1; j <= joints; ++j) {
        RS_ASSIGN_OR_RETURN(group->emplace_back(), table.Numbers(absl::StrCat(name, "_J", j)));
      }
    }
    return samples;
  }
};

double RateOf(const std::vector<double>& t) {
  std::vector<double> steps;
  for (size_t i = 1; i < t.size(); ++i) steps.push_back(t[i] - t[i - 1]);
  return std::round(1 / std::max(UpperMedian(std::move(steps)), 1e-4));
}

RecordedEpisode Cut(const Samples& samples, const Commands& commands, size_t begin, size_t end,
                    double rate_hz) {
  RecordedEpisode episode;
  episode.rate_hz = rate_hz;
  episode.group = "run";
  const auto part = [&](const std::vector<double>& channel) {
    return std::vector<double>(channel.begin() + static_cast<int64_t>(begin),
                               channel.begin() + static_cast<int64_t>(end));
  };
  episode.t = part(samples.t);
  for (size_t j = 0; j < samples.q.size(); ++j) {
    episode.q.push_back(part(samples.q[j]));
    episode.dq.push_back(part(samples.dq[j]));
    std::vector<double> tau = part(samples.tau[j]);
    for (size_t i = 0; i + 1 < tau.size(); ++i) tau[i] = 0.5 * (tau[i] + tau[i + 1]);
    episode.tau.push_back(std::move(tau));
    if (commands.t.empty()) continue;
    std::vector<double>& command = episode.command.emplace_back();
    for (const double t : episode.t) command.push_back(commands.target[j][commands.At(t)]);
  }
  return episode;
}

}  // namespace

bool IsClientRun(const std::string& run) {
  const std::filesystem::path folder = run;
  return std::filesystem::exists(folder / kTicks) ||
         std::filesystem::exists(folder / absl::StrCat(kTicks, ".partial"));
}

absl::StatusOr<std::vector<RecordedEpisode>> EpisodesOfClientRun(const std::string& run,
                                                                 int at_least) {
  RS_ASSIGN_OR_RETURN(const CsvTable ticks, ReadRunTable(run, kTicks));
  RS_ASSIGN_OR_RETURN(const CsvTable table, ReadRunTable(run, kSamples));
  RS_ASSIGN_OR_RETURN(const std::vector<Interval> driven, Driven(ticks));
  RS_ASSIGN_OR_RETURN(const Samples samples, Samples::Read(table));
  RS_ASSIGN_OR_RETURN(const Commands commands,
                      Commands::Read(ticks, static_cast<int>(samples.q.size())));
  const double rate_hz = RateOf(samples.t);
  const auto shortest = static_cast<size_t>(kShortest_s * rate_hz);
  std::vector<std::pair<size_t, size_t>> stretches;  // rows [first, last)
  double rows = 0;
  for (const Interval& interval : driven) {
    size_t i =
        std::lower_bound(samples.t.begin(), samples.t.end(), interval.begin) - samples.t.begin();
    while (i < samples.t.size() && samples.t[i] <= interval.end) {
      size_t end = i + 1;
      while (end < samples.t.size() && samples.t[end] <= interval.end &&
             samples.sequence[end] == samples.sequence[end - 1] + 1 &&
             samples.t[end] - samples.t[end - 1] < kGap / rate_hz)
        ++end;
      if (end - i >= shortest) {
        stretches.emplace_back(i, end);
        rows += static_cast<double>(end - i);
      }
      i = end;
    }
  }
  if (stretches.empty())
    return absl::FailedPreconditionError(
        absl::StrCat(run, ": no stretch of ", kShortest_s,
                     " s in which the arm ran and every sample was recorded; record an episode or "
                     "a motion on an arm"));
  const double part = static_cast<int>(stretches.size()) >= at_least ? rows : rows / at_least;
  std::vector<RecordedEpisode> episodes;
  for (const auto& [first, last] : stretches) {
    const auto length = static_cast<double>(last - first);
    const auto parts = static_cast<size_t>(std::max(1.0, std::ceil(length / part - 1e-9)));
    for (size_t k = 0; k < parts; ++k) {
      episodes.push_back(Cut(samples, commands, first + k * (last - first) / parts,
                             first + (k + 1) * (last - first) / parts, rate_hz));
      episodes.back().name = absl::StrCat("episode", episodes.size() - 1);
    }
  }
  return episodes;
}

absl::StatusOr<std::optional<std::vector<std::string>>> JointNamesOfClientRun(
    const std::string& run) {
  const std::string file = (std::filesystem::path(run) / "arm.json").string();
  if (!std::filesystem::exists(file)) return std::nullopt;
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(file, 1 << 16));
  const nlohmann::json arm = nlohmann::json::parse(text, nullptr, false);
  const auto is_name = [](const nlohmann::json& name) { return name.is_string(); };
  if (!arm.is_object() || !arm.contains("joints") || !arm["joints"].is_array() ||
      !std::all_of(arm["joints"].begin(), arm["joints"].end(), is_name))
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": has no list of names 'joints'; delete it and say --joints"));
  return arm["joints"].get<std::vector<std::string>>();
}

RecordedArm ArmResponse(const std::string& rig_name, int joints) {
  RecordedArm arm;
  arm.name = rig_name;
  arm.model_file = "unit_masses.xml";
  arm.mjcf = "<mujoco>\n  <option gravity=\"0 0 0\"/>\n  <worldbody>\n";
  for (int j = 1; j <= joints; ++j) {
    arm.joints.push_back(absl::StrCat("J", j));
    absl::StrAppend(&arm.mjcf, "    <body pos=\"0 ", j, " 0\"><joint name=\"", arm.joints.back(),
                    "\" axis=\"0 0 1\"/><inertial pos=\"0 0 0\" mass=\"1\" diaginertia=\"1 1 1\"/>"
                    "</body>\n");
  }
  arm.mjcf += "  </worldbody>\n</mujoco>\n";
  arm.input = JointInput::kPositionTarget;
  arm.servo.kp = 400;
  arm.servo.kd = 20;
  arm.effects = {{.type = kResponseDelay, .parameters = {{"delay_s", 0.05}}, .fit = {"delay_s"}},
                 {.type = kResponseDrag, .parameters = {{"c2", 20}}, .fit = {"c2"}}};
  arm.fit = {"servo.kp", "servo.kd"};
  return arm;
}

RecordedArm PiperOfRecordings(const std::string& rig_name, double payload_kg) {
  RecordedArm arm;
  arm.name = rig_name;
  arm.model_file = "piper.xml";
  piper::PiperScene scene;
  scene.payload_kg = payload_kg;
  arm.mjcf = piper::ComposePiperScene(scene);
  for (int j = 1; j <= static_cast<int>(kPiper.joints.size()); ++j)
    arm.joints.push_back(absl::StrCat("piper_joint", j));
  arm.fit = {"armature"};
  return arm;
}

}  // namespace robostress::calibration
