#include "common/wire/openpi_observation.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/image_resize.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_readers.h"

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

// For an error: the names that a client used, of a map's too.
std::string SentKeys(const OpenpiValue& message) {
  std::vector<std::string> sent;
  for (const auto& [key, value] : *message.map()) {
    const std::string name = key.substr(0, 64);
    const OpenpiValue::Map* nested = value.map();
    if (nested == nullptr || nested->empty()) sent.push_back(name);
    if (nested == nullptr) continue;
    for (const auto& [inner, ignored] : *nested)
      sent.push_back(absl::StrCat(name, "/", inner.substr(0, 64)));
  }
  sent.resize(std::min<size_t>(sent.size(), 16));
  return absl::StrJoin(sent, ", ");
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
  for (const OpenpiDialect& dialect : OpenpiDialects()) dialects.push_back(dialect.CameraPaths());
  for (std::vector<std::string>& keys : dialects) {
    if (keys.size() < n) continue;
    keys.resize(n);
    if (absl::c_all_of(keys, [&](const auto& key) { return FindPath(message, key) != nullptr; }))
      return keys;
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "no views for the cameras ", absl::StrJoin(policy.cameras, ", "), " among the keys ",
      SentKeys(message),
      "; send observation/image and observation/wrist_image, or the cameras' names, or "
      "start the server with --websocket-cameras"));
}

// Element `i` of a float array.
double FloatAt(const OpenpiArray& array, size_t i) {
  if (array.dtype == "<f4") {
    float value;
    std::memcpy(&value, array.data.data() + i * sizeof value, sizeof value);
    return static_cast<double>(value);
  }
  double value;
  std::memcpy(&value, array.data.data() + i * sizeof value, sizeof value);
  return value;
}

// Whether a view of this size is taken, as it is or resized.
absl::Status CheckViewSize(const std::string& key, int64_t width, int64_t height,
                           const PolicySpec& policy, const OpenpiInputOptions& options,
                           bool asked) {
  const auto refuse = [&](const auto&... parts) {
    return absl::InvalidArgumentError(
        absl::StrCat(key, ": is ", width, " x ", height, ", ", parts...));
  };
  if (width == policy.image_width && height == policy.image_height) return absl::OkStatus();
  if (!policy.resizes_images && !options.resize && !asked) {
    return refuse("policy ", policy.name, " takes ", policy.image_width, " x ", policy.image_height,
                  "; add session: {resize: true} to the first message, or start the server with "
                  "--websocket-resize");
  }
  const int largest = LargestViewSide(policy, options, asked);
  if (height >= 1 && width >= 1 && height <= largest && width <= largest) return absl::OkStatus();
  return refuse("a side must be 1..", largest,
                "; send smaller images, or start the server with --max-view-side");
}

// A view as the policy takes it.
absl::StatusOr<Image> ReadImage(const std::string& key, const OpenpiValue& value,
                                const PolicySpec& policy, const OpenpiInputOptions& options,
                                bool asked) {
  const auto refuse = [&key](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat(key, ": ", parts...));
  };
  const auto* array = std::get_if<OpenpiArray>(&value.value);
  if (array == nullptr) return refuse("is no array, must be an image [H, W, 3] or [3, H, W]");
  std::vector<int64_t> shape = array->shape;
  if (shape.size() == 4 && shape[0] == 1) shape.erase(shape.begin());
  const bool rows_first = shape.size() == 3 && shape[2] == 3;
  const bool planes_first = shape.size() == 3 && shape[0] == 3 && !rows_first;
  if (!rows_first && !planes_first)
    return refuse("has shape [", absl::StrJoin(array->shape, ", "),
                  "], must be [H, W, 3] or [3, H, W]");
  const int64_t height = rows_first ? shape[0] : shape[1], width = rows_first ? shape[1] : shape[2];
  RS_RETURN_IF_ERROR(CheckViewSize(key, width, height, policy, options, asked));
  const bool bytes = array->dtype == "|u1" || array->dtype == "<u1";
  if (!bytes && array->dtype != "<f4" && array->dtype != "<f8")
    return refuse("has dtype ", array->dtype, ", must be |u1, <f4 or <f8");
  Image image{static_cast<int>(width), static_cast<int>(height), {}};
  const size_t pixels = static_cast<size_t>(height * width);
  if (bytes && rows_first) {
    const auto* const first = reinterpret_cast<const uint8_t*>(array->data.data());
    image.data.assign(first, first + array->data.size());
  } else {
    image.data.resize(3 * pixels);
    const size_t planes = rows_first ? 1 : 3;  // of which each goes to every third byte
    size_t source = 0;
    for (size_t plane = 0; plane < planes; ++plane) {
      for (size_t at = plane; at < image.data.size(); at += planes, ++source) {
        if (bytes) {
          image.data[at] = static_cast<uint8_t>(array->data[source]);
          continue;
        }
        const double number = FloatAt(*array, source);
        if (!(number >= 0 && number <= 1))  // NaN too
          return refuse("[", source, "] is ", number, ", a float image must be within 0..1");
        image.data[at] = static_cast<uint8_t>(255 * number);
      }
    }
  }
  const bool fits = width == policy.image_width && height == policy.image_height;
  if (policy.resizes_images || fits) return image;
  return ResizeWithPad(image, policy.image_width, policy.image_height);
}

// The state from whichever keys the client uses.
absl::StatusOr<Eigen::VectorXf> ReadState(const OpenpiValue& message, const PolicySpec& policy) {
  const auto wanted = static_cast<size_t>(policy.state_dim);
  for (const OpenpiDialect& dialect : OpenpiDialects()) {
    const std::vector<std::string>& parts = dialect.state;
    if (FindPath(message, parts[0]) == nullptr) continue;
    size_t count = 0;
    for (const std::string& part : parts) {
      const OpenpiValue* value = FindPath(message, part);
      if (value == nullptr) {
        return absl::InvalidArgumentError(
            absl::StrCat(part, ": is missing beside ", parts[0], ", send both"));
      }
      count += OpenpiCount(*value);
    }
    if (count != wanted) {
      return absl::InvalidArgumentError(absl::StrCat(absl::StrJoin(parts, " + "), ": holds ", count,
                                                     " numbers, policy ", policy.name, " wants ",
                                                     wanted));
    }
    Eigen::VectorXf state(policy.state_dim);
    Eigen::Index at = 0;
    for (const std::string& part : parts) {
      RS_ASSIGN_OR_RETURN(const std::vector<double> numbers,
                          OpenpiNumbers(part, *FindPath(message, part), wanted));
      for (size_t i = 0; i < numbers.size(); ++i) {
        state[at] = static_cast<float>(numbers[i]);
        if (!std::isfinite(state[at++])) {
          return absl::InvalidArgumentError(
              absl::StrCat(part, "[", i, "] is ", numbers[i], ", too large for a float32"));
        }
      }
    }
    return state;
  }
  if (wanted == 0) return Eigen::VectorXf();
  return absl::InvalidArgumentError(
      absl::StrCat("no state among the keys ", SentKeys(message),
                   "; send observation/state, state, or "
                   "observation/joint_position and observation/gripper_position, ",
                   wanted, " numbers in all"));
}

}  // namespace

int LargestViewSide(const PolicySpec& policy, const OpenpiInputOptions& options, bool asked) {
  const int own = std::max(policy.image_width, policy.image_height);
  if (!policy.resizes_images && !options.resize && !asked) return own;
  if (options.max_view_side != 0) return std::max(own, options.max_view_side);
  if (policy.resizes_images) return std::max(own, policy.max_view_side);
  return std::max(own, options.resize ? kResizedViewSide : kResizedOnRequestSide);
}

absl::StatusOr<Observation> ReadOpenpiObservation(const OpenpiValue& message,
                                                  const PolicySpec& policy,
                                                  const OpenpiInputOptions& options, bool asked) {
  Observation observation;
  observation.instruction = options.default_prompt;
  if (const OpenpiValue* prompt = message.Find("prompt")) {
    RS_ASSIGN_OR_RETURN(observation.instruction,
                        OpenpiText("prompt", *prompt, WireLimits::kInstruction));
  } else if (options.default_prompt.empty()) {
    return absl::InvalidArgumentError(
        "prompt: is missing; send it, or start the server with --websocket-prompt");
  }
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> keys, CameraKeys(message, policy, options));
  for (size_t i = 0; i < keys.size(); ++i) {
    const OpenpiValue* view = FindPath(message, keys[i]);
    if (view == nullptr) {
      return absl::InvalidArgumentError(
          absl::StrCat(keys[i], ": is missing among the keys ", SentKeys(message)));
    }
    RS_ASSIGN_OR_RETURN(Image image, ReadImage(keys[i], *view, policy, options, asked));
    observation.views.push_back({policy.cameras[i], std::move(image)});
  }
  RS_ASSIGN_OR_RETURN(observation.proprioception, ReadState(message, policy));
  RS_RETURN_IF_ERROR(CheckObservation(observation, policy));
  return observation;
}

}  // namespace robostress
