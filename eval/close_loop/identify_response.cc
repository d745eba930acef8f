#include "eval/close_loop/identify_response.h"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "adapter/disturbance_observer.h"
#include "calibration/data/client_recordings.h"
#include "calibration/data/rig.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "eval/close_loop/found_effects.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr char kCommand[] = "identify";
constexpr double kWindow_s = 0.5;  // several delays and settling times

absl::StatusOr<JointResponseOptions> ResponseOf(const calibration::Rig& calibrated) {
  JointResponseOptions response;
  for (const calibration::RigJoint& joint : calibrated.joints) {
    const std::vector<calibration::DeclaredEffect>& effects = joint.effects;
    if (effects.size() != 2 || effects[0].type != calibration::kResponseDelay ||
        effects[1].type != calibration::kResponseDrag)
      return absl::InvalidArgumentError(
          absl::StrCat(calibrated.file, ": joint ", joint.name, " has not the effects ",
                       calibration::kResponseDelay, " and ", calibration::kResponseDrag,
                       "; remove the folder and identify again"));
    const double delay_s = effects[0].parameters.at("delay_s");
    response.delay_s.push_back(std::clamp(delay_s, 0.0, JointResponse::kMaxDelay_s));
    response.stiffness.push_back(joint.servo.kp);
    response.damping.push_back(std::max(0.0, joint.servo.kd));
    response.drag.push_back(std::max(0.0, effects[1].parameters.at("c2")));
  }
  RS_RETURN_IF_ERROR(response.Check(static_cast<int>(calibrated.joints.size())));
  return response;
}

}  // namespace

absl::StatusOr<ResponseIdentification> IdentifyResponse(const std::string& run,
                                                        const std::string& out, int surrogates,
                                                        uint64_t seed) {
  const auto place = [&](const char* name) { return (fs::path(out) / name).string(); };
  RS_RETURN_IF_ERROR(MakeDirectories(out));
  RS_RETURN_IF_ERROR(KeepCircleOptions(
      place("options.json"),
      {{"run", fs::absolute(run).string()}, {"surrogates", surrogates}, {"seed", seed}}));
  calibration::RecordedRigOptions rig;
  rig.encoder_noise = 0;
  rig.window_s = kWindow_s;
  RS_ASSIGN_OR_RETURN(std::vector<calibration::RecordedEpisode> episodes,
                      calibration::EpisodesOfClientRun(run, rig.held_out_every));
  if (episodes.front().command.empty())
    return absl::InvalidArgumentError(
        absl::StrCat(run,
                     "/ticks.csv: has no columns sent_J1 ..., what was sent to the arm; give a "
                     "run that robot_client recorded"));
  for (calibration::RecordedEpisode& episode : episodes) episode.dq.clear();
  ResponseIdentification identified;
  RS_ASSIGN_OR_RETURN(
      identified.rig,
      calibration::WriteRecordedRig(
          calibration::ArmResponse("arm_response", static_cast<int>(episodes.front().q.size())),
          episodes, rig, place("rig")));
  const auto start = std::chrono::steady_clock::now();
  RS_RETURN_IF_ERROR(RunCalibration(kCommand, place("rig/rig.yaml"), place("calibration"),
                                    place("calibration.log"), surrogates, seed, 0));
  identified.seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  RS_ASSIGN_OR_RETURN(const calibration::Rig after,
                      calibration::ReadRig(place("calibration/rig_after.yaml")));
  RS_ASSIGN_OR_RETURN(identified.response, ResponseOf(after));
  identified.file = place("response.yaml");
  RS_RETURN_IF_ERROR(WriteFileAtomically(
      identified.file,
      absl::StrCat("# What `robostress identify --run ", run,
                   "` found; a part of the client's configuration.\n"
                   "control:\n  observer: true\n  disturbance_observer:\n    ",
                   absl::StrReplaceAll(DumpConfig(ObserverAround(identified.response, true)),
                                       {{"\n", "\n    "}}),
                   "\n")));
  return identified;
}

std::string ResponseTable(const ResponseIdentification& identified) {
  const JointResponseOptions& response = identified.response;
  std::string text = absl::StrFormat("%s  %d pieces, %.1f s of free motion, calibrated in %.0f s\n",
                                     identified.file, identified.rig.pieces, identified.rig.seconds,
                                     identified.seconds);
  for (size_t j = 0; j < response.delay_s.size(); ++j)
    absl::StrAppendFormat(
        &text, "  J%d  delay %.1f ms, stiffness %.0f 1/s^2, damping %.1f 1/s, drag %.1f 1/rad\n",
        j + 1, 1e3 * response.delay_s[j], response.stiffness[j], response.damping[j],
        response.drag[j]);
  return text;
}

}  // namespace robostress
