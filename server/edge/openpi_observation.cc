#include "server/edge/openpi_observation.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/rpc/convert.h"
#include "common/rpc/spec_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// A key as it is, else down nested maps: "images/cam_high".
const OpenpiValue* FindPath(const OpenpiValue& message, const std::string& path) {
  if (const OpenpiValue* found = message.Find(path)) return found;
  const OpenpiValue* at = &message;
  const std::vector<std::string> keys = absl::StrSplit(path, '/');
  for (const std::string& key : keys) {
    at = at->Find(key);
    if (at == nullptr) return nullptr;
  }
  return at;
}

// Keys of the cameras, in the policy's order.
absl::StatusOr<std::vector<std::string>> CameraKeys(const OpenpiValue& message,
                                                    const PolicySpec& policy,
                                                    const OpenpiInputOptions& options) {
  const size_t n = policy.cameras.size();
  if (!options.camera_keys.empty()) {
    if (options.camera_keys.size() == n) return options.camera_keys;
    return absl::InvalidArgumentError(absl::StrCat("camera keys: ", options.camera_keys.size(),
                                                   " are configured, policy ", policy.name, " has ",
                                                   n, " cameras"));
  }
  std::vector<std::vector<std::string>> dialects(3);
  for (const std::string& camera : policy.cameras) {
    dialects[0].push_back(camera);
    dialects[1].push_back(absl::StrCat("images/", camera));
    dialects[2].push_back(absl::StrCat("observation/", camera));
  }
  dialects.push_back({"observation/image", "observation/wrist_image"});  // LIBERO
  dialects.push_back(
      {"observation/exterior_image_1_left", "observation/wrist_image_left"});  // DROID
  dialects.push_back(
      {"images/cam_high", "images/cam_left_wrist", "images/cam_right_wrist"});  // ALOHA
  for (std::vector<std::string>& keys : dialects) {
    if (keys.size() < n) continue;
    keys.resize(n);
    if (absl::c_all_of(keys, [&](const auto& key) { return FindPath(message, key) != nullptr; }))
      return keys;
  }
  std::vector<std::string> sent;
  for (const auto& [key, value] : *message.map()) sent.push_back(key.substr(0, 64));
  sent.resize(std::min<size_t>(sent.size(), 16));
  return absl::InvalidArgumentError(
      absl::StrCat("no views for the cameras ", absl::StrJoin(policy.cameras, ", "),
                   " among the keys ", absl::StrJoin(sent, ", "),
                   "; send observation/image and observation/wrist_image, or the "
                   "cameras' names"));
}

absl::StatusOr<Image> ReadImage(const std::string& key, const OpenpiValue& value) {
  const auto refuse = [&key](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(key, ": ", parts...));
  };
  const auto* array = std::get_if<OpenpiArray>(&value.value);
  if (array == nullptr) return refuse("is no array");
  std::vector<int64_t> shape = array->shape;
  if (shape.size() == 4 && shape[0] == 1) shape.erase(shape.begin());
  const bool rows_first = shape.size() == 3 && shape[2] == 3;
  const bool planes_first = shape.size() == 3 && shape[0] == 3 && !rows_first;
  if (!rows_first && !planes_first)
    return refuse("has shape [", absl::StrJoin(array->shape, ", "),
                  "], must be [H, W, 3] or [3, H, W]");
  Image image;
  const int64_t height = rows_first ? shape[0] : shape[1], width = rows_first ? shape[1] : shape[2];
  if (height < 1 || width < 1 || height > kMaxViewSide || width > kMaxViewSide)
    return refuse("is ", width, " x ", height, ", a side must be 1..", kMaxViewSide);
  image.height = static_cast<int>(height);
  image.width = static_cast<int>(width);
  const size_t pixels = static_cast<size_t>(height * width);
  std::vector<uint8_t> bytes(3 * pixels);
  if (array->dtype == "|u1" || array->dtype == "<u1") {
    std::memcpy(bytes.data(), array->data.data(), bytes.size());
  } else if (array->dtype == "<f4" || array->dtype == "<f8") {
    RS_ASSIGN_OR_RETURN(const std::vector<double> values, OpenpiNumbers(key, value));
    for (size_t i = 0; i < bytes.size(); ++i) {
      if (values[i] < 0 || values[i] > 1)
        return refuse("[", i, "] is ", values[i], ", a float image must be within 0..1");
      bytes[i] = static_cast<uint8_t>(255 * values[i]);
    }
  } else {
    return refuse("has dtype ", array->dtype, ", must be |u1, <f4 or <f8");
  }
  if (rows_first) {
    image.data = std::move(bytes);
  } else {
    image.data.resize(bytes.size());
    for (size_t c = 0; c < 3; ++c) {
      for (size_t i = 0; i < pixels; ++i) image.data[3 * i + c] = bytes[c * pixels + i];
    }
  }
  return image;
}

}  // namespace

absl::StatusOr<Observation> ReadOpenpiObservation(const OpenpiValue& message,
                                                  const PolicySpec& policy,
                                                  const OpenpiInputOptions& options) {
  Observation observation;
  observation.instruction = options.default_prompt;
  if (const OpenpiValue* prompt = message.Find("prompt")) {
    RS_ASSIGN_OR_RETURN(observation.instruction,
                        OpenpiText("prompt", *prompt, WireLimits::kInstruction));
  } else if (options.default_prompt.empty()) {
    return absl::InvalidArgumentError("prompt: is missing");
  }
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> keys, CameraKeys(message, policy, options));
  for (size_t i = 0; i < keys.size(); ++i) {
    const OpenpiValue* view = FindPath(message, keys[i]);
    if (view == nullptr) return absl::InvalidArgumentError(absl::StrCat(keys[i], ": is missing"));
    RS_ASSIGN_OR_RETURN(Image image, ReadImage(keys[i], *view));
    observation.views.push_back({policy.cameras[i], std::move(image)});
  }
  std::vector<double> state;
  for (const std::vector<std::string>& parts :
       {std::vector<std::string>{"observation/state"},
        {"state"},
        {"observation/joint_position", "observation/gripper_position"}}) {
    if (message.Find(parts[0]) == nullptr) continue;
    for (const std::string& part : parts) {
      const OpenpiValue* value = message.Find(part);
      if (value == nullptr) return absl::InvalidArgumentError(absl::StrCat(part, ": is missing"));
      RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, OpenpiNumbers(part, *value));
      state.insert(state.end(), numbers.begin(), numbers.end());
    }
    if (static_cast<int>(state.size()) != policy.state_dim)
      return absl::InvalidArgumentError(absl::StrCat(absl::StrJoin(parts, " + "), ": holds ",
                                                     state.size(), " numbers, policy ", policy.name,
                                                     " wants ", policy.state_dim));
    break;
  }
  if (state.empty() && policy.state_dim > 0)
    return absl::InvalidArgumentError("observation/state: is missing");
  observation.proprioception.resize(static_cast<Eigen::Index>(state.size()));
  for (size_t i = 0; i < state.size(); ++i) {
    const auto value = static_cast<float>(state[i]);
    if (!std::isfinite(value))
      return absl::InvalidArgumentError(
          absl::StrCat("observation/state[", i, "] is ", state[i], ", too large for a float32"));
    observation.proprioception[static_cast<Eigen::Index>(i)] = value;
  }
  RS_RETURN_IF_ERROR(CheckObservation(observation, policy));
  return observation;
}

}  // namespace robostress
