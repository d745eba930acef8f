#include "sim_worker/environment/environment_door.h"

#include <cmath>
#include <istream>
#include <ostream>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kLongestLine = 1 << 16;

template <class Vector>
Json Numbers(const Vector& values) {
  Json list = Json::array();
  for (Eigen::Index i = 0; i < values.size(); ++i) list.push_back(static_cast<double>(values[i]));
  return list;
}

Json StateJson(const RobotState& state) {
  const Eigen::Quaterniond& turn = state.tool.q_base_tool;
  return {{"stamp_s", state.stamp_s},
          {"q", Numbers(state.q)},
          {"dq", Numbers(state.dq)},
          {"position", Numbers(state.tool.p_base_tool)},
          {"quaternion", {turn.w(), turn.x(), turn.y(), turn.z()}},
          {"gripper", state.gripper}};
}

absl::StatusOr<Eigen::VectorXf> CommandOf(const Json& step, int action_dim) {
  if (!step.is_array() || static_cast<int>(step.size()) != action_dim)
    return absl::InvalidArgumentError(
        absl::StrCat("step is ", step.dump(), ", must be a list of ", action_dim, " numbers"));
  Eigen::VectorXf command(action_dim);
  for (int i = 0; i < action_dim; ++i) {
    if (!step[i].is_number())
      return absl::InvalidArgumentError(
          absl::StrCat("step[", i, "] is ", step[i].dump(), ", must be a number"));
    command[i] = step[i].get<float>();
    if (!std::isfinite(command[i]))
      return absl::InvalidArgumentError(
          absl::StrCat("step[", i, "] is ", step[i].dump(), ", must be a finite 32-bit number"));
  }
  return command;
}

class Door {
 public:
  Door(Robot& robot, const EnvironmentViews& views, int action_dim)
      : robot_(robot), action_dim_(action_dim) {
    spec_.cameras = views.cameras;
    spec_.image_width = spec_.image_height = views.size;
  }

  struct Answer {
    std::string line;
    std::vector<CameraView> views;
  };
  absl::StatusOr<Answer> To(const std::string& text) {
    const Json request = Json::parse(text, nullptr, /*allow_exceptions=*/false);
    if (!request.is_object() || request.size() != 1)
      return absl::InvalidArgumentError(R"(a request is {"reset": STATE} or {"step": [...]})");
    const auto& [key, value] = *request.items().begin();
    if (key == "reset") {
      RS_RETURN_IF_ERROR(Reset(value));
    } else if (key == "step") {
      RS_RETURN_IF_ERROR(Step(value));
    } else {
      return absl::InvalidArgumentError(
          absl::StrCat("request '", key, "' is unknown; known: reset, step"));
    }
    return Look();
  }

 private:
  absl::Status Reset(const Json& state) {
    if (!state.is_number_integer() || state < 0 || state > std::numeric_limits<int>::max())
      return absl::InvalidArgumentError(
          absl::StrCat("reset is ", state.dump(), ", must be the number of an initial state"));
    RS_RETURN_IF_ERROR(robot_.Reset(state.get<int>()));
    steps_ = 0;
    begun_ = true;
    return absl::OkStatus();
  }

  absl::Status Step(const Json& step) {
    if (!begun_) return absl::FailedPreconditionError("step comes before the first reset");
    RS_ASSIGN_OR_RETURN(const Eigen::VectorXf command, CommandOf(step, action_dim_));
    RS_RETURN_IF_ERROR(robot_.Step(command));
    ++steps_;
    return absl::OkStatus();
  }

  absl::StatusOr<Answer> Look() {
    RS_ASSIGN_OR_RETURN(Observation seen, robot_.Observe(spec_));
    RS_ASSIGN_OR_RETURN(const RobotState state, robot_.Measure());
    size_t bytes = 0;
    for (const CameraView& view : seen.views) bytes += view.image.data.size();
    const Json line = {{"step", steps_},
                       {"success", robot_.Success()},
                       {"agent_pos", Numbers(seen.proprioception)},
                       {"instruction", seen.instruction},
                       {"image_bytes", bytes},
                       {"state", StateJson(state)}};
    return Answer{line.dump(), std::move(seen.views)};
  }

  Robot& robot_;
  const int action_dim_;
  PolicySpec spec_;
  int steps_ = 0;
  bool begun_ = false;
};

// False: there is none.
absl::StatusOr<bool> ReadLine(std::istream& in, std::string& line) {
  line.clear();
  for (int c = in.get(); c != std::istream::traits_type::eof(); c = in.get()) {
    if (c == '\n') return true;
    if (line.size() == kLongestLine)
      return absl::InvalidArgumentError(
          absl::StrCat("a request is longer than ", kLongestLine, " bytes"));
    line.push_back(static_cast<char>(c));
  }
  return !line.empty();
}

}  // namespace

absl::Status ServeEnvironment(Robot& robot, const EnvironmentViews& views, int action_dim,
                              std::istream& in, std::ostream& out) {
  Door door(robot, views, action_dim);
  std::string line;
  while (true) {
    RS_ASSIGN_OR_RETURN(const bool more, ReadLine(in, line));
    if (!more) return absl::OkStatus();
    const absl::StatusOr<Door::Answer> answer = door.To(line);
    if (answer.ok()) {
      out << answer->line << '\n';
      for (const CameraView& view : answer->views)
        out.write(reinterpret_cast<const char*>(view.image.data.data()),
                  static_cast<std::streamsize>(view.image.data.size()));
    } else {
      out << Json{{"error", answer.status().message()}}.dump(-1, ' ', false,
                                                             Json::error_handler_t::replace)
          << '\n';
    }
    if (!out.flush()) return absl::UnavailableError("the other program has closed its end");
  }
}

}  // namespace robostress
