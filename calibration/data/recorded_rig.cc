#include "calibration/data/recorded_rig.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
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

}  // namespace

absl::StatusOr<RecordedRigSummary> WriteRecordedRig(const RecordedArm& arm,
                                                    const std::vector<RecordedEpisode>& episodes,
                                                    const RecordedRigOptions& options,
                                                    const std::string& out) {
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  Rig rig;
  rig.file = (std::filesystem::path(out) / "rig.yaml").string();
  rig.name = arm.name;
  rig.model = (std::filesystem::path(out) / arm.model_file).string();
  rig.folds = Folds::kCondition;
  rig.metric.window_s = options.window_s;
  rig.metric.unit = "rad";
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
  RS_RETURN_IF_ERROR(WriteFileAtomically(rig.model, arm.mjcf));
  RS_RETURN_IF_ERROR(WriteFileAtomically(rig.file, WriteRig(rig)));
  return summary;
}

}  // namespace robostress::calibration
