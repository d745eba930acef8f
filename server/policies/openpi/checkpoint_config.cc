#include "server/policies/openpi/checkpoint_config.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

using Json = nlohmann::json;

// Reads fields and keeps what is wrong with each; null counts as absent.
class FieldReader {
 public:
  explicit FieldReader(const Json& json) : json_(json) {}

  void Integer(const char* key, int64_t max, std::optional<int64_t>& value) {
    const Json* found = Find(json_, key);
    if (found == nullptr) return;
    if (!found->is_number_integer() || *found < 1 || *found > max) {
      return Complain(key, *found, absl::StrCat("an integer in 1..", max));
    }
    if (value && *value != found->get<int64_t>()) {
      return Complain(key, *found, absl::StrCat(*value, " as another field says"));
    }
    value = found->get<int64_t>();
  }

  void Text(const char* key, std::string& value) {
    const Json* found = Find(json_, key);
    if (found == nullptr) return;
    if (!found->is_string()) return Complain(key, *found, "a text");
    value = found->get<std::string>();
  }

  // [height, width] of a square image.
  void Square(const char* key, int64_t max, std::optional<int64_t>& value) {
    const Json* found = Find(json_, key);
    if (found == nullptr) return;
    const bool pair = found->is_array() && found->size() == 2 && (*found)[0].is_number_integer() &&
                      (*found)[0] == (*found)[1] && (*found)[0] >= 1 && (*found)[0] <= max;
    if (!pair) return Complain(key, *found, absl::StrCat("[s, s] with s in 1..", max));
    value = (*found)[0].get<int64_t>();
  }

  // {"KEY": "MODE"}.
  void Modes(const char* key, std::map<std::string, std::string>& modes) {
    const Json* found = Find(json_, key);
    if (found == nullptr) return;
    if (!found->is_object()) return Complain(key, *found, "an object");
    for (const auto& [name, mode] : found->items()) {
      if (!mode.is_string()) return Complain(absl::StrCat(key, ".", name), mode, "a text");
      modes[name] = mode.get<std::string>();
    }
  }

  // The features of `key` by name with the length of their shape's first extent.
  void Features(const char* key, CheckpointConfig& config) {
    const Json* found = Find(json_, key);
    if (found == nullptr) return;
    if (!found->is_object()) return Complain(key, *found, "an object");
    for (const auto& [name, feature] : found->items()) {
      const Json* shape = feature.is_object() ? Find(feature, "shape") : nullptr;
      if (shape == nullptr || !shape->is_array() || shape->empty() ||
          !(*shape)[0].is_number_integer() || (*shape)[0] < 1 || (*shape)[0] > kMaxExtent) {
        Complain(absl::StrCat(key, ".", name), feature, "an object with a shape");
      } else if (absl::StartsWith(name, "observation.image")) {
        config.cameras.push_back(name);
      } else if (name == "observation.state") {
        config.robot_state_dim = (*shape)[0].get<int64_t>();
      } else if (name == "action") {
        config.robot_action_dim = (*shape)[0].get<int64_t>();
      }
    }
  }

  void Complain(const std::string& key, const Json& value, const std::string& wanted) {
    std::string text = value.dump(-1, ' ', false, Json::error_handler_t::replace);
    if (text.size() > kMaxShown) text = text.substr(0, kMaxShown) + "...";
    problems_.push_back(absl::StrCat(key, " is ", text, ", must be ", wanted));
  }
  const std::vector<std::string>& problems() const { return problems_; }

 private:
  static constexpr int64_t kMaxExtent = 1 << 16;
  static constexpr size_t kMaxShown = 80;
  static const Json* Find(const Json& json, const char* key) {
    const auto found = json.find(key);
    return found == json.end() || found->is_null() ? nullptr : &*found;
  }
  const Json& json_;
  std::vector<std::string> problems_;
};

// LeRobot's policy type; any other policy is not ours to load.
void ReadType(FieldReader& reader, CheckpointConfig& config) {
  std::string type;
  reader.Text("type", type);
  if (type.empty()) return;
  config.writer = CheckpointConfig::Writer::kLerobot;
  if (type == "pi0" || type == "pi05") {
    config.pi05 = type == "pi05";
  } else {
    reader.Complain("type", Json(type), "pi0 or pi05: other policies cannot be loaded");
  }
}

}  // namespace

absl::StatusOr<CheckpointConfig> ParseCheckpointConfig(const std::string& file,
                                                       const std::string& text) {
  const absl::StatusOr<Json> json = ParseJsonObject(text);
  if (!json.ok())
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", json.status().message()));
  CheckpointConfig config;
  config.file = file;
  config.writer = CheckpointConfig::Writer::kOpenpi;
  FieldReader reader(*json);
  ReadType(reader, config);
  reader.Text("paligemma_variant", config.paligemma_variant);
  reader.Text("action_expert_variant", config.action_expert_variant);
  reader.Text("precision", config.precision);
  reader.Text("dtype", config.precision);
  reader.Integer("action_dim", 4096, config.action_dim);
  reader.Integer("max_action_dim", 4096, config.action_dim);
  reader.Integer("max_state_dim", 4096, config.state_dim);
  reader.Integer("action_horizon", 4096, config.horizon);
  reader.Integer("chunk_size", 4096, config.horizon);
  reader.Integer("tokenizer_max_length", 1 << 16, config.prompt_tokens);
  reader.Square("image_resolution", 4096, config.image);
  reader.Square("resize_imgs_with_padding", 4096, config.image);
  reader.Integer("num_inference_steps", 1000, config.euler_steps);
  reader.Integer("num_steps", 1000, config.euler_steps);
  reader.Features("input_features", config);
  reader.Features("output_features", config);
  reader.Modes("normalization_mapping", config.normalization);
  RS_RETURN_IF_ERROR(ProblemList(file, "not the configuration of a pi0 or pi0.5 checkpoint",
                                 reader.problems(),
                                 "Take config.json as openpi's converter or LeRobot wrote it"));
  return config;
}

}  // namespace robostress::openpi
