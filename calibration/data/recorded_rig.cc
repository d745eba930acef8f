#include "calibration/data/recorded_rig.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

struct Piece {
  size_t first = 0, last = 0;  // rows, [first, last)
};

// Whether every joint moves by more than its readings' noise, as a log of a rig must
// (measured_log.cc). A joint that sticks can stand still for a whole piece.
bool EveryJointMoves(const RecordedEpisode& episode, const Piece& piece,
                     const RecordedRigOptions& options) {
  constexpr double kLeast = 25;  // times the noise; a log needs 20
  for (const std::vector<double>& q : episode.q) {
    const auto [low, high] = std::minmax_element(q.begin() + piece.first, q.begin() + piece.last);
    if (*high - *low < kLeast * options.encoder_noise) return false;
  }
  return true;
}

// Runs of rows that no contact is near and in which every joint moves.
std::vector<Piece> FreePieces(const RecordedEpisode& episode, const RecordedRigOptions& options) {
  const size_t rows = episode.t.size();
  const auto margin = static_cast<size_t>(std::lround(options.contact_margin_s * episode.rate_hz));
  const auto shortest = static_cast<size_t>(std::lround(options.min_piece_s * episode.rate_hz));
  std::vector<char> out(rows, 0);
  for (size_t i = 0; i < episode.contact_N.size(); ++i) {
    if (episode.contact_N[i] <= options.contact_limit_N) continue;
    const size_t begin = i > margin ? i - margin : 0, end = std::min(rows, i + margin + 1);
    std::fill(out.begin() + begin, out.begin() + end, 1);
  }
  std::vector<Piece> pieces;
  for (size_t i = 0; i < rows;) {
    if (out[i]) {
      ++i;
      continue;
    }
    size_t end = i;
    while (end < rows && !out[end]) ++end;
    if (end - i >= shortest && EveryJointMoves(episode, {i, end}, options))
      pieces.push_back({i, end});
    i = end;
  }
  return pieces;
}

LogRole RoleOf(const std::vector<std::string>& groups, const std::string& group, int index,
               const RecordedRigOptions& options) {
  if (options.transfer && groups.size() > 1 && group == groups.back()) return LogRole::kTransfer;
  return index % options.held_out_every == options.held_out_every - 1 ? LogRole::kHeldOut
                                                                      : LogRole::kFit;
}

const std::vector<std::vector<double>>& Drive(const RecordedArm& arm,
                                              const RecordedEpisode& episode) {
  return arm.input == JointInput::kPositionTarget ? episode.command : episode.tau;
}

absl::Status CheckEpisode(const RecordedArm& arm, const RecordedEpisode& episode) {
  const auto fits = [&](const std::vector<std::vector<double>>& channels) {
    return channels.size() == arm.joints.size() &&
           std::all_of(channels.begin(), channels.end(), [&](const std::vector<double>& channel) {
             return channel.size() == episode.t.size();
           });
  };
  if (episode.rate_hz > 0 && fits(episode.q) && fits(Drive(arm, episode)) &&
      (episode.dq.empty() || fits(episode.dq)) &&
      (episode.contact_N.empty() || episode.contact_N.size() == episode.t.size()))
    return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      "episode ", episode.name, " has ", episode.t.size(), " rows and ", episode.q.size(),
      " joints, the arm has ", arm.joints.size(), "; all channels must have one value per row"));
}

std::string PieceCsv(const RecordedArm& arm, const RecordedEpisode& episode, const Piece& piece,
                     const RecordedRigOptions& options, int index) {
  std::string csv = "t";
  const bool with_dq = !episode.dq.empty();
  const std::vector<std::vector<double>>& drive = Drive(arm, episode);
  const char* const driven = arm.input == JointInput::kPositionTarget ? ",q_cmd_" : ",tau_";
  for (const std::string& joint : arm.joints)
    absl::StrAppend(&csv, ",q_", joint, with_dq ? ",dq_" + joint : "", driven, joint);
  csv += "\n";
  RandomStream noise(StreamKey("encoder noise")
                         .With(static_cast<int64_t>(options.seed))
                         .With(episode.name)
                         .With(index));
  for (size_t i = piece.first; i < piece.last; ++i) {
    absl::StrAppendFormat(&csv, "%.6f", episode.t[i]);
    for (size_t j = 0; j < arm.joints.size(); ++j) {
      const double q = episode.q[j][i] + options.encoder_noise * noise.Normal();
      absl::StrAppendFormat(&csv, ",%.10g", q);
      if (with_dq) {
        const double error =
            RecordedRigOptions::kVelocityNoise * options.encoder_noise * noise.Normal();
        absl::StrAppendFormat(&csv, ",%.9g", episode.dq[j][i] + error);
      }
      absl::StrAppendFormat(&csv, ",%.9g", drive[j][i]);
    }
    csv += "\n";
  }
  return csv;
}

// Model and joints, without logs.
Rig BareRig(const RecordedArm& arm, const std::string& out) {
  Rig rig;
  if (arm.declared) {
    rig = *arm.declared;
    rig.joints.clear();
    rig.logs.clear();
    rig.rate_hz = 0;
    for (const std::string& name : arm.joints)
      rig.joints.push_back(
          *std::find_if(arm.declared->joints.begin(), arm.declared->joints.end(),
                        [&](const RigJoint& declared) { return declared.name == name; }));
    return rig;
  }
  rig.model = (std::filesystem::path(out) / arm.model_file).string();
  for (const std::string& name : arm.joints) {
    RigJoint joint;
    joint.name = name;
    joint.input = arm.input;
    joint.servo = arm.servo;
    joint.effects = arm.effects;
    joint.velocity = arm.velocity;
    joint.fit = arm.fit;
    rig.joints.push_back(std::move(joint));
  }
  return rig;
}

}  // namespace

absl::StatusOr<RecordedArm> ArmOfRig(const Rig& rig, std::vector<std::string> names,
                                     std::vector<RecordedEpisode>* episodes) {
  const size_t joints = episodes->front().q.size();
  std::vector<std::string> known;
  for (const RigJoint& joint : rig.joints) known.push_back(joint.name);
  if (names.empty()) names = known;
  if (names.size() != joints)
    return absl::InvalidArgumentError(absl::StrCat(
        "the run is of ", joints, " joints, the names are ", names.size(), " (",
        absl::StrJoin(names, ", "), "); give --joints ", joints,
        " names of J1 and on, those of the rig by its names, any other for what it leaves out"));
  RecordedArm arm;
  arm.name = rig.name;
  arm.declared = rig;
  arm.input = rig.joints.front().input;
  std::vector<size_t> taken;
  for (size_t j = 0; j < joints; ++j) {
    if (std::find(known.begin(), known.end(), names[j]) == known.end()) continue;
    if (std::count(names.begin(), names.end(), names[j]) > 1)
      return absl::InvalidArgumentError(absl::StrCat("--joints has '", names[j], "' twice"));
    arm.joints.push_back(names[j]);
    taken.push_back(j);
  }
  if (arm.joints.size() != known.size())
    return absl::InvalidArgumentError(absl::StrCat("--joints [", absl::StrJoin(names, ", "),
                                                   "] must hold every joint of ", rig.file, ": ",
                                                   absl::StrJoin(known, ", ")));
  for (const RigJoint& joint : rig.joints) {
    if (joint.input != arm.input ||
        (arm.input != JointInput::kPositionTarget && arm.input != JointInput::kTorque))
      return absl::InvalidArgumentError(absl::StrCat(
          rig.file, ": joint ", joint.name,
          ": the joints' input must be position_target or torque, and one for all of them, for "
          "what a run records"));
  }
  // What a driver does not measure is recorded as 0.
  const auto silent = [](const std::vector<double>& channel) {
    return std::all_of(channel.begin(), channel.end(), [](double value) { return value == 0; });
  };
  for (const size_t j : taken) {
    const bool measured =
        std::any_of(episodes->begin(), episodes->end(),
                    [&](const RecordedEpisode& episode) { return !silent(episode.tau[j]); });
    if (arm.input == JointInput::kTorque && !measured)
      return absl::FailedPreconditionError(
          absl::StrCat("the run has no torques of ", names[j], ", and ", rig.file,
                       " drives its joints by them; give them input: position_target and a servo"));
  }
  for (RecordedEpisode& episode : *episodes) {
    for (auto channels : {&episode.q, &episode.dq, &episode.tau, &episode.command}) {
      if (channels->empty()) continue;
      std::vector<std::vector<double>> of_rig;
      for (const size_t j : taken) of_rig.push_back(std::move((*channels)[j]));
      *channels = std::move(of_rig);
    }
  }
  return arm;
}

absl::StatusOr<RecordedRigSummary> WriteRecordedRig(const RecordedArm& arm,
                                                    const std::vector<RecordedEpisode>& episodes,
                                                    const RecordedRigOptions& options,
                                                    const std::string& out) {
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  Rig rig = BareRig(arm, out);
  rig.file = (std::filesystem::path(out) / "rig.yaml").string();
  rig.name = arm.name;
  rig.folds = Folds::kCondition;
  rig.metric.window_s = options.window_s;
  rig.metric.unit = "rad";
  std::vector<std::string> groups;
  std::map<std::string, int> count;
  for (const RecordedEpisode& episode : episodes) {
    if (count[episode.group]++ == 0) groups.push_back(episode.group);
  }
  count.clear();
  RecordedRigSummary summary;
  summary.rig_file = rig.file;
  for (const RecordedEpisode& episode : episodes) {
    RS_RETURN_IF_ERROR(CheckEpisode(arm, episode));
    if (rig.rate_hz != 0 && rig.rate_hz != episode.rate_hz)
      return absl::InvalidArgumentError(absl::StrCat("episode ", episode.name, " has ",
                                                     episode.rate_hz, " rows per second, others ",
                                                     rig.rate_hz, "; a rig has one rate"));
    rig.rate_hz = episode.rate_hz;
    const LogRole role = RoleOf(groups, episode.group, count[episode.group]++, options);
    double kept = 0;
    int index = 0;
    for (const Piece& piece : FreePieces(episode, options)) {
      RigLog log;
      const std::string name = absl::StrCat(episode.name, "_", index, ".csv");
      log.file = (std::filesystem::path(out) / name).string();
      log.role = role;
      log.condition = episode.name;
      RS_RETURN_IF_ERROR(
          WriteFileAtomically(log.file, PieceCsv(arm, episode, piece, options, index++)));
      rig.logs.push_back(std::move(log));
      kept += static_cast<double>(piece.last - piece.first) / episode.rate_hz;
      ++summary.pieces;
      ++summary.logs_of_role[static_cast<int>(role)];
    }
    ++summary.episodes;
    summary.seconds += kept;
    summary.seconds_left_out += static_cast<double>(episode.t.size()) / episode.rate_hz - kept;
  }
  if (summary.logs_of_role[0] == 0 || summary.logs_of_role[1] == 0)
    return absl::FailedPreconditionError(absl::StrFormat(
        "%d episodes leave %d logs to fit and %d to hold out (pieces of at least %g s without "
        "contact above %g N); record at least %d episodes of a task",
        summary.episodes, summary.logs_of_role[0], summary.logs_of_role[1], options.min_piece_s,
        options.contact_limit_N, options.held_out_every));
  if (!arm.declared) RS_RETURN_IF_ERROR(WriteFileAtomically(rig.model, arm.mjcf));
  RS_RETURN_IF_ERROR(WriteFileAtomically(rig.file, WriteRig(rig)));
  return summary;
}

}  // namespace robostress::calibration
