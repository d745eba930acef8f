#include "calibration/fidelity/measured_replays.h"

#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr std::array<const char*, 7> kColumns = {"t", "x", "y", "z", "held", "loaded", "replay"};
enum Column { kT, kX, kY, kZ, kHeld, kLoaded, kReplay };
constexpr uint64_t kMaxBytes = 200u << 20;

absl::Status BadLine(const std::string& path, int line, const std::string& what) {
  return absl::InvalidArgumentError(absl::StrCat(path, ":", line, ": ", what));
}

// Where each of kColumns stands.
absl::StatusOr<std::array<int, 7>> ReadHeader(const std::string& path, const std::string& header) {
  const std::vector<std::string> names = absl::StrSplit(header, ',');
  std::array<int, 7> place;
  place.fill(-1);
  for (size_t i = 0; i < names.size(); ++i) {
    for (size_t c = 0; c < kColumns.size(); ++c) {
      if (names[i] == kColumns[c]) place[c] = static_cast<int>(i);
    }
  }
  for (size_t c = 0; c < kColumns.size(); ++c) {
    if (place[c] < 0) {
      return BadLine(path, 1,
                     absl::StrCat("column '", kColumns[c], "' is missing; the header must name ",
                                  absl::StrJoin(kColumns, ", ")));
    }
  }
  return place;
}

absl::Status CheckReplay(const std::string& path, bool loaded, int number, const Replay& replay) {
  const absl::StatusOr<GraspSpan> span = FindGrasp(replay);
  if (span.ok()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": ", loaded ? "loaded" : "unloaded", " replay ", number, ": ",
                   span.status().message(), "; column 'held' must be 1 from grasp to release"));
}

Scenario OwnErrors() {
  Scenario scenario;
  scenario.name = "measured_arm";
  scenario.title = "Measured arm";
  scenario.friction_on = scenario.backlash_on = scenario.compliance_on = true;
  scenario.start = scenario.end = std::vector<SeverityFactors>(7);
  return scenario;
}

}  // namespace

absl::StatusOr<MeasuredReplays> ReadMeasuredReplays(const std::string& dir) {
  const std::string path = dir + "/replays.csv";
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMaxBytes));
  std::vector<std::string> lines = absl::StrSplit(text, '\n');
  for (std::string& line : lines) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
  }
  RS_ASSIGN_OR_RETURN(const auto place, ReadHeader(path, lines[0]));
  std::map<std::pair<bool, int>, Replay> replays;  // by (loaded, number)
  for (size_t i = 1; i < lines.size(); ++i) {
    if (lines[i].empty()) continue;
    const int line = static_cast<int>(i) + 1;
    const std::vector<std::string> cells = absl::StrSplit(lines[i], ',');
    std::array<double, 7> row;
    for (size_t c = 0; c < kColumns.size(); ++c) {
      if (place[c] >= static_cast<int>(cells.size()) ||
          !absl::SimpleAtod(cells[place[c]], &row[c]) || !std::isfinite(row[c])) {
        return BadLine(
            path, line,
            absl::StrCat("column '", kColumns[c], "': '",
                         place[c] < static_cast<int>(cells.size()) ? cells[place[c]] : "",
                         "' is not a finite number"));
      }
    }
    for (const Column c : {kHeld, kLoaded}) {
      if (row[c] != 0 && row[c] != 1)
        return BadLine(path, line,
                       absl::StrCat("column '", kColumns[c], "': ", row[c], " must be 0 or 1"));
    }
    Replay& replay = replays[{row[kLoaded] == 1, static_cast<int>(row[kReplay])}];
    if (!replay.t.empty() && row[kT] <= replay.t.back()) {
      return BadLine(path, line,
                     absl::StrFormat("column 't': %g s does not follow %g s of the same replay; "
                                     "rows of a replay must be in the order of time",
                                     row[kT], replay.t.back()));
    }
    replay.t.push_back(row[kT]);
    replay.p.emplace_back(row[kX], row[kY], row[kZ]);
    replay.held.push_back(row[kHeld] == 1);
  }
  MeasuredReplays measured;
  measured.source = path;
  for (auto& [key, replay] : replays) {
    RS_RETURN_IF_ERROR(CheckReplay(path, key.first, key.second, replay));
    (key.first ? measured.loaded : measured.unloaded).push_back(std::move(replay));
  }
  if (measured.loaded.empty() || measured.unloaded.empty()) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s: %d loaded and %d unloaded replays; both kinds are needed (column 'loaded')", path,
        measured.loaded.size(), measured.unloaded.size()));
  }
  return measured;
}

std::string WriteMeasuredReplays(const MeasuredReplays& measured) {
  std::string text = absl::StrJoin(kColumns, ",") + "\n";
  for (const bool loaded : {false, true}) {
    const std::vector<Replay>& replays = loaded ? measured.loaded : measured.unloaded;
    for (size_t k = 0; k < replays.size(); ++k) {
      for (size_t i = 0; i < replays[k].t.size(); ++i) {
        const Eigen::Vector3d& p = replays[k].p[i];
        absl::StrAppendFormat(&text, "%.4f,%.7f,%.7f,%.7f,%d,%d,%d\n", replays[k].t[i], p.x(),
                              p.y(), p.z(), replays[k].held[i], loaded, k);
      }
    }
  }
  return text;
}

absl::StatusOr<MeasuredReplays> SimulateMeasuredReplays(const SimulatedArm& arm) {
  ReplayTask task = arm.task;
  task.sim.joint_errors.friction_law = FrictionLaw::kStick;
  MeasuredReplays measured;
  Demonstration demonstration;
  for (const bool loaded : {false, true}) {
    RS_ASSIGN_OR_RETURN(const std::unique_ptr<ReplayArm> robot,
                        ReplayArm::Create(task, loaded ? arm.payload_kg : 0));
    if (!loaded) {
      RS_ASSIGN_OR_RETURN(demonstration, robot->Record(arm.layout, OwnErrors()));
    }
    for (int k = 0; k < arm.replays; ++k) {
      RandomStream random(StreamKey("fidelity/measured").With(arm.seed).With(loaded).With(k));
      ReplayConditions conditions;
      conditions.scenario = OwnErrors();
      for (double& q : conditions.q_offset) q = arm.joint_start * random.Normal();
      for (double& p : conditions.object_offset) p = arm.object_place * random.Normal();
      RS_ASSIGN_OR_RETURN(Replay replay, robot->Run(arm.layout, demonstration, conditions));
      RS_RETURN_IF_ERROR(CheckReplay("the simulated arm", loaded, k, replay));
      (loaded ? measured.loaded : measured.unloaded).push_back(std::move(replay));
    }
    measured.source = absl::StrFormat("simulated Panda, '%s', %g kg added to an object of %g kg",
                                      robot->instruction(), arm.payload_kg, robot->object_mass());
  }
  return measured;
}

absl::StatusOr<MeasuredProfiles> MeasureProfiles(const MeasuredReplays& measured) {
  MeasuredProfiles profiles;
  const double n = static_cast<double>(measured.unloaded.size());
  for (const Replay& replay : measured.unloaded) {
    RS_ASSIGN_OR_RETURN(const GraspSpan span, FindGrasp(replay));
    profiles.span.start += span.start / n, profiles.span.grasp += span.grasp / n;
    profiles.span.release += span.release / n, profiles.span.end += span.end / n;
  }
  std::vector<std::vector<Eigen::Vector3d>> unloaded, loaded;
  for (const Replay& replay : measured.unloaded)
    unloaded.push_back(AtPhases(replay, profiles.span));
  for (const Replay& replay : measured.loaded) loaded.push_back(AtPhases(replay, profiles.span));
  const std::vector<Eigen::Vector3d> reference = MeanPath(unloaded), mean = MeanPath(loaded);
  for (const auto& path : loaded) profiles.loaded.push_back(Deviation(path, reference));
  for (size_t k = 0; k < unloaded.size() && unloaded.size() > 1; ++k) {
    std::vector<std::vector<Eigen::Vector3d>> others = unloaded;
    others.erase(others.begin() + static_cast<long>(k));
    profiles.unloaded.push_back(Deviation(unloaded[k], MeanPath(others)));
  }
  for (int i = 0; i < kPhases; ++i) profiles.vertical.push_back((mean[i] - reference[i]).z());
  return profiles;
}

}  // namespace robostress::calibration
