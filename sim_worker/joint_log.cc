#include "sim_worker/joint_log.h"

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr char kFormat[] = "robostress.joint_log.1";
constexpr int kJoints = 7;

// [rows, 7] from a member of every item.
template <class Items, class Row>
std::vector<double> Table(const Items& items, const Row& row) {
  std::vector<double> values;
  values.reserve(items.size() * kJoints);
  for (const auto& item : items) {
    const auto vector = row(item);
    for (int j = 0; j < kJoints; ++j) values.push_back(static_cast<double>(vector[j]));
  }
  return values;
}

using Row7 = Eigen::Matrix<double, kJoints, 1>;

Row7 ToolRow(const RobotState& state) {
  const Eigen::Quaterniond& q = state.tool.q_base_tool;
  Row7 row;
  row << state.tool.p_base_tool, q.w(), q.x(), q.y(), q.z();
  return row;
}

class Reader {
 public:
  explicit Reader(const SafetensorsFile& file) : file_(file) {}

  absl::StatusOr<std::string> Text(const std::string& key) const {
    const auto found = file_.metadata().find(key);
    if (found != file_.metadata().end()) return found->second;
    return absl::DataLossError(absl::StrCat(file_.path(), ": metadata has no '", key, "'"));
  }
  absl::Status Number(const std::string& key, int& value) const {
    RS_ASSIGN_OR_RETURN(const std::string text, Text(key));
    if (absl::SimpleAtoi(text, &value)) return absl::OkStatus();
    return absl::DataLossError(
        absl::StrCat(file_.path(), ": metadata '", key, "' is '", text, "', must be a number"));
  }

 private:
  const SafetensorsFile& file_;
};

}  // namespace

absl::Status WriteJointLog(const JointLog& log, const std::string& file) {
  SafetensorsWriter writer;
  for (const auto& [key, value] : {std::pair<const char*, std::string>{"format", kFormat},
                                   {"suite", log.suite},
                                   {"scenario", log.scenario},
                                   {"policy", log.policy},
                                   {"severity", absl::StrCat(log.severity)},
                                   {"task", absl::StrCat(log.task)},
                                   {"episode", absl::StrCat(log.episode)},
                                   {"initial_state", absl::StrCat(log.initial_state)},
                                   {"success", absl::StrCat(log.success ? 1 : 0)},
                                   {"rate_hz", absl::StrCat(JointLog::kRateHz)}})
    writer.SetMetadata(key, value);
  std::vector<double> t, contact;
  for (const JointSample& sample : log.samples) {
    t.push_back(sample.t);
    contact.push_back(sample.contact_N);
  }
  const auto rows = static_cast<int64_t>(log.samples.size());
  const auto steps = static_cast<int64_t>(log.actions.size());
  const auto states = static_cast<int64_t>(log.states.size());
  writer.AddDoubles("t", {rows}, t);
  writer.AddDoubles("contact_N", {rows}, contact);
  const auto add = [&](const char* name, int64_t count, const std::vector<double>& values) {
    writer.AddDoubles(name, {count, kJoints}, values);
  };
  add("q", rows, Table(log.samples, [](const JointSample& s) { return s.q; }));
  add("dq", rows, Table(log.samples, [](const JointSample& s) { return s.dq; }));
  add("tau", rows, Table(log.samples, [](const JointSample& s) { return s.tau; }));
  add("actions", steps, Table(log.actions, [](const Eigen::VectorXf& a) { return a; }));
  add("step_q", states, Table(log.states, [](const RobotState& s) { return s.q; }));
  add("step_tool", states, Table(log.states, ToolRow));
  return writer.Write(file);
}

absl::StatusOr<JointLog> ReadJointLog(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  const Reader reader(file);
  RS_ASSIGN_OR_RETURN(const std::string format, reader.Text("format"));
  if (format != kFormat)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": format is '", format, "', must be '", kFormat, "'"));
  JointLog log;
  RS_ASSIGN_OR_RETURN(log.suite, reader.Text("suite"));
  RS_ASSIGN_OR_RETURN(log.scenario, reader.Text("scenario"));
  RS_ASSIGN_OR_RETURN(log.policy, reader.Text("policy"));
  RS_RETURN_IF_ERROR(reader.Number("severity", log.severity));
  RS_RETURN_IF_ERROR(reader.Number("task", log.task));
  RS_RETURN_IF_ERROR(reader.Number("episode", log.episode));
  RS_RETURN_IF_ERROR(reader.Number("initial_state", log.initial_state));
  int success = 0;
  RS_RETURN_IF_ERROR(reader.Number("success", success));
  log.success = success != 0;
  RS_ASSIGN_OR_RETURN(const std::vector<double> t, file.ReadDoubles("t", {-1}));
  const auto rows = static_cast<int64_t>(t.size());
  RS_ASSIGN_OR_RETURN(const auto contact, file.ReadDoubles("contact_N", {rows}));
  RS_ASSIGN_OR_RETURN(const auto q, file.ReadDoubles("q", {rows, kJoints}));
  RS_ASSIGN_OR_RETURN(const auto dq, file.ReadDoubles("dq", {rows, kJoints}));
  RS_ASSIGN_OR_RETURN(const auto tau, file.ReadDoubles("tau", {rows, kJoints}));
  for (size_t i = 0; i < t.size(); ++i) {
    const auto row = [&](const std::vector<double>& table) {
      return Eigen::Map<const Row7>(table.data() + i * kJoints);
    };
    log.samples.push_back({t[i], row(q), row(dq), row(tau), contact[i]});
  }
  RS_ASSIGN_OR_RETURN(const auto actions, file.ReadDoubles("actions", {-1, kJoints}));
  const size_t steps = actions.size() / kJoints, states = steps == 0 ? 0 : steps + 1;
  for (size_t i = 0; i < steps; ++i)
    log.actions.push_back(Eigen::Map<const Row7>(actions.data() + i * kJoints).cast<float>());
  const std::vector<int64_t> shape = {static_cast<int64_t>(states), kJoints};
  RS_ASSIGN_OR_RETURN(const auto step_q, file.ReadDoubles("step_q", shape));
  RS_ASSIGN_OR_RETURN(const auto step_tool, file.ReadDoubles("step_tool", shape));
  for (size_t i = 0; i < states; ++i) {
    RobotState& state = log.states.emplace_back();
    const double* tool = step_tool.data() + i * kJoints;
    state.stamp_s = 0.05 * static_cast<double>(i);
    state.q = Eigen::Map<const Row7>(step_q.data() + i * kJoints);
    state.tool.p_base_tool = Eigen::Map<const Eigen::Vector3d>(tool);
    state.tool.q_base_tool = Eigen::Quaterniond(tool[3], tool[4], tool[5], tool[6]);
  }
  return log;
}

}  // namespace robostress
