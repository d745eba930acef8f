#include "calibration/fidelity/measured_replays.h"

#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/csv_table.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr std::array<const char*, 7> kColumns = {"t", "x", "y", "z", "held", "loaded", "replay"};
enum Column { kT, kX, kY, kZ, kHeld, kLoaded, kReplay };
constexpr uint64_t kMaxBytes = 200u << 20;

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
  scenario.nominal = NominalPandaErrors();
  scenario.start = scenario.end = std::vector<SeverityFactors>(scenario.nominal.size());
  return scenario;
}

}  // namespace

absl::StatusOr<MeasuredReplays> ReadMeasuredReplays(const std::string& dir) {
  const std::string path = dir + "/replays.csv";
  RS_ASSIGN_OR_RETURN(const CsvTable table,
                      CsvTable::Read(path, kMaxBytes, CsvTable::ShortLastLine::kError));
  std::array<size_t, kColumns.size()> place{};
  for (size_t c = 0; c < kColumns.size(); ++c) {
    RS_ASSIGN_OR_RETURN(place[c], table.Column(kColumns[c]));
  }
  std::map<std::pair<bool, int>, Replay> replays;  // by (loaded, number)
  for (size_t i = 0; i < table.rows(); ++i) {
    std::array<double, kColumns.size()> row{};
    for (size_t c = 0; c < kColumns.size(); ++c) {
      RS_ASSIGN_OR_RETURN(row[c], table.Number(i, place[c]));
    }
    for (const Column c : {kHeld, kLoaded}) {
      if (row[c] != 0 && row[c] != 1)
        return absl::InvalidArgumentError(
            absl::StrCat(table.Place(i, place[c]), " is ", row[c], ", must be 0 or 1"));
    }
    if (!(row[kReplay] >= 0 && row[kReplay] <= 1e6) || row[kReplay] != std::floor(row[kReplay]))
      return absl::InvalidArgumentError(absl::StrCat(table.Place(i, place[kReplay]), " is ",
                                                     row[kReplay],
                                                     ", must be a whole number from 0 to 1000000"));
    Replay& replay = replays[{row[kLoaded] == 1, static_cast<int>(row[kReplay])}];
    if (!replay.t.empty() && row[kT] <= replay.t.back()) {
      return absl::InvalidArgumentError(
          absl::StrFormat("%s: %g s does not follow %g s of the same replay; rows of a replay must "
                          "be in the order of time",
                          table.Place(i, place[kT]), row[kT], replay.t.back()));
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
