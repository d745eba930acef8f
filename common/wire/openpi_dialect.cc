#include "common/wire/openpi_dialect.h"

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "common/wire/openpi_writer.h"

namespace robostress {
namespace {

// Beside the pixels: keys, shapes, state, prompt.
constexpr size_t kRestBytes = 4096;
constexpr int kVlaEvalImageSize = 256;  // [px], its LIBERO benchmark's

}  // namespace

const std::vector<OpenpiDialect>& OpenpiDialects() {
  static const auto& dialects = *new std::vector<OpenpiDialect>{
      {.name = "libero",
       .cameras = {"observation/image", "observation/wrist_image"},
       .images_in = "",
       .state = {"observation/state"},
       .state_sizes = {}},
      {.name = "aloha",
       .cameras = {"cam_high", "cam_left_wrist", "cam_right_wrist"},
       .images_in = "images",
       .planes_first = true,
       .state = {"state"},
       .state_sizes = {}},
      {.name = "droid",
       .cameras = {"observation/exterior_image_1_left", "observation/wrist_image_left"},
       .images_in = "",
       .state = {"observation/joint_position", "observation/gripper_position"},
       .state_sizes = {7}}};
  return dialects;
}

const std::vector<OpenpiDialect>& ServerDialects() {
  static const auto& dialects =
      *new std::vector<OpenpiDialect>{{.name = "vllm_omni",
                                       .cameras = {"observation/image", "observation/wrist_image"},
                                       .state = {"observation/state"},
                                       .path = "/v1/realtime/robot/openpi",
                                       .seed = "seed",
                                       .reset = "endpoint",
                                       .reset_text = "reset",
                                       .session = "session_id"},
                                      {.name = "sglang",
                                       .images_in = "images",
                                       .state = {"state"},
                                       .path = "/openpi/policy",
                                       .noise = "noise"},
                                      {.name = "lerobot",
                                       .cameras = {"observation/image", "observation/wrist_image"},
                                       .state = {"observation/state"},
                                       .seed = "seed",
                                       .reset = "reset"},
                                      {.name = "robostress",
                                       .state = {"state"},
                                       .episode = "episode",
                                       .session = "session",
                                       .describes_session = true},
                                      {.name = "vla_eval",
                                       .cameras = {"agentview", "wrist"},
                                       .images_in = "images",
                                       .state = {"states"},
                                       .prompt = "task_description",
                                       .wire = kVlaEvalWire}};
  return dialects;
}

absl::StatusOr<OpenpiDialect> OpenpiDialectNamed(const std::string& name) {
  std::vector<std::string> known;
  for (const auto* dialects : {&OpenpiDialects(), &ServerDialects()}) {
    for (const OpenpiDialect& dialect : *dialects) {
      if (dialect.name == name) return dialect;
      known.push_back(dialect.name);
    }
  }
  return absl::InvalidArgumentError(
      absl::StrCat("no dialect '", name, "'; known: ", absl::StrJoin(known, ", ")));
}

void UseDialect(OpenpiDialect dialect, RemotePolicyOptions& options) {
  if (dialect.wire == kVlaEvalWire) {
    options.image_size = kVlaEvalImageSize;
    options.execute_steps = 1;
  }
  options.dialect = std::move(dialect);
}

absl::StatusOr<std::string> WriteOpenpiObservation(
    const Observation& observation, const OpenpiDialect& dialect,
    const std::vector<std::pair<std::string, std::string>>& extras) {
  const size_t views = observation.views.size(), parts = dialect.state.size();
  if (!dialect.cameras.empty() && dialect.cameras.size() < views) {
    return absl::InvalidArgumentError(
        absl::StrCat("dialect ", dialect.name, " has keys for ", dialect.cameras.size(),
                     " cameras, the observation has ", views, " views"));
  }
  const int first_parts =
      std::accumulate(dialect.state_sizes.begin(), dialect.state_sizes.end(), 0);
  const auto numbers = static_cast<int>(observation.proprioception.size());
  if (dialect.state_sizes.size() + 1 != std::max<size_t>(parts, 1) || numbers < first_parts) {
    return absl::InvalidArgumentError(absl::StrCat(
        "dialect ", dialect.name, " parts the state into ", absl::StrJoin(dialect.state, " + "),
        " of ", absl::StrJoin(dialect.state_sizes, " + "), " and the rest; the state has ", numbers,
        " numbers"));
  }
  const bool vla_eval = dialect.wire == kVlaEvalWire;
  OpenpiWriter writer(vla_eval ? OpenpiWriter::ArrayKeys::kText : OpenpiWriter::ArrayKeys::kBytes);
  size_t bytes = kRestBytes;
  for (const CameraView& view : observation.views) bytes += view.image.data.size();
  for (const auto& [key, value] : extras) bytes += key.size() + value.size();
  writer.Reserve(bytes);

  const bool nested = !dialect.images_in.empty();
  writer.Map(static_cast<uint32_t>((nested ? 1 : views) + parts + 1 + extras.size()));
  if (nested) writer.Text(dialect.images_in).Map(static_cast<uint32_t>(views));
  for (size_t i = 0; i < views; ++i) {
    const CameraView& view = observation.views[i];
    writer.Text(dialect.cameras.empty() ? view.camera : dialect.cameras[i]);
    if (vla_eval) {
      RS_ASSIGN_OR_RETURN(const std::string png, EncodePng(view.image));
      writer.Png(png, view.image.width, view.image.height);
      continue;
    }
    writer.Pixels(view.image, dialect.planes_first);
  }
  const std::vector<double> state(observation.proprioception.begin(),
                                  observation.proprioception.end());
  auto at = state.begin();
  for (size_t i = 0; i < parts; ++i) {
    const auto end = i + 1 < parts ? at + dialect.state_sizes[i] : state.end();
    writer.Text(dialect.state[i]).Numbers({at, end});
    at = end;
  }
  writer.Text(dialect.prompt).Text(observation.instruction);
  for (const auto& [key, value] : extras) writer.Text(key).Value(value);
  return writer.Take();
}

}  // namespace robostress
