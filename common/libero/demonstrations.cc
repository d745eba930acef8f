#include "common/libero/demonstrations.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

constexpr int64_t kMaxSteps = 100000, kMaxDemonstrations = 100000;
constexpr int64_t kMinSide = 8, kMaxSide = 2048;  // of an image [px]

// Rows in the other order.
void FlipRows(Image& image) {
  const size_t line = size_t{3} * image.width;
  for (int row = 0; row < image.height / 2; ++row) {
    std::swap_ranges(image.data.begin() + row * line, image.data.begin() + (row + 1) * line,
                     image.data.end() - (row + 1) * line);
  }
}

absl::Status WriteViews(Hdf5File& file, const std::string& name, const std::vector<Image>& views) {
  std::vector<uint8_t> bytes;
  for (Image image : views) {
    if (image.width != views[0].width || image.height != views[0].height) {
      return absl::InvalidArgumentError(
          absl::StrCat(file.path(), ": ", name, " would mix images of ", views[0].width, "x",
                       views[0].height, " and ", image.width, "x", image.height));
    }
    FlipRows(image);
    bytes.insert(bytes.end(), image.data.begin(), image.data.end());
  }
  return file.WriteBytes(
      name, {static_cast<int64_t>(views.size()), views[0].height, views[0].width, 3}, bytes);
}

// Whether robosuite's controller was told that actions are targets.
bool SaysAbsolute(const std::string& env_args) {
  const nlohmann::json args = nlohmann::json::parse(env_args, nullptr, /*allow_exceptions=*/false);
  const nlohmann::json* value = &args;
  for (const char* key : {"env_kwargs", "controller_configs", "control_delta"}) {
    if (!value->is_object() || !value->contains(key)) return false;
    value = &(*value)[key];
  }
  return value->is_boolean() && !value->get<bool>();
}

// LIBERO writes the instruction as a text or as a list of texts, sometimes in quotes.
absl::StatusOr<std::string> InstructionOf(const std::string& path, const std::string& text) {
  const nlohmann::json info = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  std::string instruction;
  if (info.is_object() && info.contains("language_instruction")) {
    const nlohmann::json& value = info["language_instruction"];
    if (value.is_string()) instruction = value.get<std::string>();
    if (value.is_array()) {
      for (const nlohmann::json& part : value) {
        if (part.is_string()) instruction += part.get<std::string>();
      }
    }
  }
  absl::string_view stripped = instruction;
  absl::ConsumePrefix(&stripped, "\"");
  absl::ConsumeSuffix(&stripped, "\"");
  if (stripped.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": data@problem_info has no language_instruction: '", text.substr(0, 80), "'"));
  }
  return std::string(stripped);
}

}  // namespace

void LiberoColumns::Add(const SimulatorRow& row) {
  const auto append = [](std::vector<double>& column, const auto& values) {
    column.insert(column.end(), values.begin(), values.end());
  };
  append(states, row.state);
  append(robot_states, row.fingers);
  append(robot_states, row.ee_pos);
  append(robot_states, row.ee_quat);
  append(ee_pos, row.ee_pos);
  append(ee_ori, row.ee_ori);
  append(gripper_states, row.fingers);
  append(joint_states, row.joints);
}

absl::StatusOr<LiberoDemonstrationWriter> LiberoDemonstrationWriter::Create(const std::string& path,
                                                                            const Task& task) {
  RS_ASSIGN_OR_RETURN(Hdf5File file, Hdf5File::Create(path));
  const std::string name = task.problem.empty() ? task.suite : task.problem;
  const std::string bddl = absl::StrCat(
      task.problem.empty() ? "" : absl::StrCat("bddl_files/", task.suite, "/"), task.task, ".bddl");
  const nlohmann::json problem = {{"problem_name", name},
                                  {"domain_name", "robosuite"},
                                  {"language_instruction", task.instruction}};
  nlohmann::json env_args = {{"type", 1},
                             {"env_name", name},
                             {"problem_name", name},
                             {"bddl_file", bddl},
                             {"env_kwargs", {{"control_freq", task.control_hz}}}};
  if (task.absolute_actions)
    env_args["env_kwargs"]["controller_configs"] = {{"type", "JOINT_POSITION"},
                                                    {"control_delta", false}};
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "tag", std::string("robostress")));
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "env_name", name));
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "env_args", env_args.dump()));
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "problem_info", problem.dump()));
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "bddl_file_name", bddl));
  RS_RETURN_IF_ERROR(file.SetAttribute("data", "macros_image_convention", std::string("opengl")));
  return LiberoDemonstrationWriter(std::move(file));
}

absl::Status LiberoDemonstrationWriter::Add(const LiberoDemonstration& demonstration) {
  const LiberoColumns& columns = demonstration.columns;
  const int64_t steps = columns.steps;
  const std::string group = absl::StrCat("data/demo_", demonstrations_), obs = group + "/obs";
  if (steps < 1 || static_cast<int64_t>(demonstration.agentview.size()) != steps ||
      static_cast<int64_t>(demonstration.eye_in_hand.size()) != steps) {
    return absl::InvalidArgumentError(absl::StrCat(
        file_.path(), ": ", group, " has ", steps, " steps and ", demonstration.agentview.size(),
        " and ", demonstration.eye_in_hand.size(), " images"));
  }
  const auto add = [&](const std::string& name, const std::vector<double>& values) -> absl::Status {
    const int64_t width = static_cast<int64_t>(values.size()) / steps;
    if (width < 1 || width * steps != static_cast<int64_t>(values.size())) {
      return absl::InvalidArgumentError(absl::StrCat(
          file_.path(), ": ", name, " has ", values.size(), " values for ", steps, " steps"));
    }
    return file_.WriteDoubles(name, {steps, width}, values);
  };
  RS_RETURN_IF_ERROR(add(group + "/actions", columns.actions));
  if (!columns.sent.empty()) RS_RETURN_IF_ERROR(add(group + "/actions_sent", columns.sent));
  if (!columns.measured.empty())
    RS_RETURN_IF_ERROR(add(group + "/actions_measured", columns.measured));
  RS_RETURN_IF_ERROR(add(group + "/states", columns.states));
  RS_RETURN_IF_ERROR(add(group + "/robot_states", columns.robot_states));
  RS_RETURN_IF_ERROR(add(obs + "/ee_pos", columns.ee_pos));
  RS_RETURN_IF_ERROR(add(obs + "/ee_ori", columns.ee_ori));
  RS_RETURN_IF_ERROR(add(obs + "/gripper_states", columns.gripper_states));
  RS_RETURN_IF_ERROR(add(obs + "/joint_states", columns.joint_states));
  std::vector<double> ee_states;
  for (int64_t t = 0; t < steps; ++t) {
    ee_states.insert(ee_states.end(), &columns.ee_pos[3 * t], &columns.ee_pos[3 * t] + 3);
    ee_states.insert(ee_states.end(), &columns.ee_ori[3 * t], &columns.ee_ori[3 * t] + 3);
  }
  RS_RETURN_IF_ERROR(add(obs + "/ee_states", ee_states));
  if (!columns.proprioception.empty())
    RS_RETURN_IF_ERROR(add(obs + "/proprioception", columns.proprioception));
  if (!columns.aux.empty()) RS_RETURN_IF_ERROR(add(obs + "/aux", columns.aux));
  RS_RETURN_IF_ERROR(WriteViews(file_, obs + "/agentview_rgb", demonstration.agentview));
  RS_RETURN_IF_ERROR(WriteViews(file_, obs + "/eye_in_hand_rgb", demonstration.eye_in_hand));
  std::vector<uint8_t> last(steps, 0);
  last.back() = 1;
  RS_RETURN_IF_ERROR(file_.WriteBytes(group + "/dones", {steps}, last));
  last.back() = demonstration.success ? 1 : 0;
  RS_RETURN_IF_ERROR(file_.WriteBytes(group + "/rewards", {steps}, last));
  RS_RETURN_IF_ERROR(file_.SetAttribute(group, "num_samples", steps));
  RS_RETURN_IF_ERROR(file_.SetAttribute(group, "model_file", demonstration.model_file));
  if (demonstration.initial_state.has_value())
    RS_RETURN_IF_ERROR(file_.SetAttribute(group, "initial_state", *demonstration.initial_state));
  if (!demonstration.origin.empty())
    RS_RETURN_IF_ERROR(file_.SetAttribute(group, "origin", demonstration.origin));
  RS_RETURN_IF_ERROR(file_.SetAttribute(
      group, "init_state",
      absl::MakeConstSpan(columns.states).subspan(0, columns.states.size() / steps)));
  ++demonstrations_;
  steps_ += steps;
  return absl::OkStatus();
}

absl::Status LiberoDemonstrationWriter::Publish() {
  RS_RETURN_IF_ERROR(file_.SetAttribute("data", "num_demos", demonstrations_));
  RS_RETURN_IF_ERROR(file_.SetAttribute("data", "total", steps_));
  return file_.Publish();
}

absl::StatusOr<LiberoDemonstrationFile> LiberoDemonstrationFile::Open(const std::string& path) {
  RS_ASSIGN_OR_RETURN(Hdf5File hdf5, Hdf5File::Open(path));
  LiberoDemonstrationFile file(std::move(hdf5));
  RS_RETURN_IF_ERROR(file.ReadTask());
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> children, file.file_.Children("data"));
  std::vector<std::pair<int64_t, std::string>> groups;
  for (const std::string& name : children) {
    absl::string_view number = name;
    int64_t index = 0;
    if (!absl::ConsumePrefix(&number, "demo_") || !absl::SimpleAtoi(number, &index) || index < 0) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": data/", name, " is not named demo_<number>"));
    }
    groups.emplace_back(index, "data/" + name);
  }
  if (groups.empty() || static_cast<int64_t>(groups.size()) > kMaxDemonstrations) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": holds ", groups.size(), " demonstrations, must be 1 to ", kMaxDemonstrations));
  }
  std::sort(groups.begin(), groups.end());
  file.has_proprioception_ = file.has_aux_ = true;
  for (const auto& [index, group] : groups) {
    RS_ASSIGN_OR_RETURN(Entry entry, file.CheckDemonstration(group));
    file.has_proprioception_ &= file.file_.Has(group + "/obs/proprioception");
    file.has_aux_ &= file.file_.Has(group + "/obs/aux");
    file.entries_.push_back(std::move(entry));
  }
  return file;
}

absl::Status LiberoDemonstrationFile::ReadTask() {
  RS_ASSIGN_OR_RETURN(const std::string problem, file_.StringAttribute("data", "problem_info"));
  RS_ASSIGN_OR_RETURN(instruction_, InstructionOf(path(), problem));
  if (const auto env_args = file_.StringAttribute("data", "env_args"); env_args.ok())
    absolute_actions_ = SaysAbsolute(*env_args);
  const absl::StatusOr<std::string> convention =
      file_.StringAttribute("data", "macros_image_convention");
  if (absl::IsNotFound(convention.status()))
    return absl::OkStatus();  // robosuite's default, opengl
  RS_RETURN_IF_ERROR(convention.status());
  if (*convention != "opengl" && *convention != "opencv") {
    return absl::InvalidArgumentError(absl::StrCat(path(), ": data@macros_image_convention is '",
                                                   *convention, "', must be opengl or opencv"));
  }
  bottom_row_first_ = *convention == "opengl";
  return absl::OkStatus();
}

absl::StatusOr<LiberoDemonstrationFile::Entry> LiberoDemonstrationFile::CheckDemonstration(
    const std::string& group) const {
  Entry entry{group};
  for (const char* name : {"/obs/agentview_rgb", "/obs/eye_in_hand_rgb"}) {
    RS_ASSIGN_OR_RETURN(const Hdf5Dataset views, file_.Describe(group + name));
    const std::vector<int64_t>& shape = views.shape;
    const auto side = [](int64_t pixels) { return pixels >= kMinSide && pixels <= kMaxSide; };
    if (views.type != Hdf5Dataset::Type::kUnsignedByte || shape.size() != 4 || shape[0] < 1 ||
        shape[0] > kMaxSteps || !side(shape[1]) || !side(shape[2]) || shape[3] != 3) {
      return absl::InvalidArgumentError(
          absl::StrCat(path(), ": ", group, name, " is [", absl::StrJoin(shape, ","),
                       "], must be uint8 [T,H,W,3], T up to ", kMaxSteps, ", sides ", kMinSide,
                       " to ", kMaxSide));
    }
    if (entry.steps != 0 &&
        (shape[0] != entry.steps || shape[1] != entry.height || shape[2] != entry.width)) {
      return absl::InvalidArgumentError(absl::StrCat(
          path(), ": ", group, name, " is [", absl::StrJoin(shape, ","), "], the other view is [",
          entry.steps, ",", entry.height, ",", entry.width, ",3]"));
    }
    entry.steps = shape[0];
    entry.height = static_cast<int>(shape[1]);
    entry.width = static_cast<int>(shape[2]);
  }
  RS_ASSIGN_OR_RETURN(const int64_t samples, file_.IntAttribute(group, "num_samples"));
  if (samples != entry.steps) {
    return absl::InvalidArgumentError(absl::StrCat(path(), ": ", group, "@num_samples is ", samples,
                                                   ", the images are ", entry.steps));
  }
  return entry;
}

absl::StatusOr<LiberoColumns> LiberoDemonstrationFile::ReadColumns(int64_t demonstration) const {
  const Entry& entry = entries_[demonstration];
  const auto read = [&](const char* name, int64_t width) {
    return file_.ReadDoubles(entry.group + name, {entry.steps, width}, kMaxSteps);
  };
  LiberoColumns columns;
  columns.steps = entry.steps;
  RS_ASSIGN_OR_RETURN(columns.actions, read("/actions", 7));
  RS_ASSIGN_OR_RETURN(columns.ee_pos, read("/obs/ee_pos", 3));
  RS_ASSIGN_OR_RETURN(columns.ee_ori, read("/obs/ee_ori", 3));
  RS_ASSIGN_OR_RETURN(columns.gripper_states, read("/obs/gripper_states", 2));
  RS_ASSIGN_OR_RETURN(columns.joint_states, read("/obs/joint_states", 7));
  if (has_proprioception_) {
    RS_ASSIGN_OR_RETURN(columns.proprioception, read("/obs/proprioception", 8));
  }
  if (has_aux_) {
    RS_ASSIGN_OR_RETURN(columns.aux, read("/obs/aux", 8));
  }
  return columns;
}

absl::StatusOr<Image> LiberoDemonstrationFile::ReadView(int64_t demonstration, View view,
                                                        int64_t step) const {
  const Entry& entry = entries_[demonstration];
  Image image{entry.width, entry.height,
              std::vector<uint8_t>(size_t{3} * entry.width * entry.height)};
  RS_RETURN_IF_ERROR(file_.ReadByteRow(
      entry.group + (view == View::kAgent ? "/obs/agentview_rgb" : "/obs/eye_in_hand_rgb"), step,
      absl::MakeSpan(image.data)));
  if (bottom_row_first_) FlipRows(image);
  return image;
}

}  // namespace robostress
