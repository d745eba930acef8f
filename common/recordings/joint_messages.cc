#include "common/recordings/joint_messages.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int64_t kNanoseconds = 1'000'000'000;

// A struct of a message with its type, so that fields are found by name.
class Node {
 public:
  Node(const RosSchema& schema, size_t type, const CdrValue& value)
      : schema_(&schema), type_(type), value_(&value) {}

  const CdrValue* Find(absl::string_view name) const {
    const size_t at = IndexOf(name);
    return at < value_->items.size() ? &value_->items[at] : nullptr;
  }
  absl::StatusOr<Node> Struct(absl::string_view name) const {
    const size_t at = IndexOf(name);
    if (at >= value_->items.size() || Field(at).kind != RosField::Kind::kStruct || Field(at).array)
      return Missing(name, "struct");
    return Node(*schema_, Field(at).type, value_->items[at]);
  }
  // The last entry of an array of structs.
  absl::StatusOr<Node> Last(absl::string_view name) const {
    const size_t at = IndexOf(name);
    if (at >= value_->items.size() || Field(at).kind != RosField::Kind::kStruct ||
        value_->items[at].items.empty())
      return Missing(name, "point");
    return Node(*schema_, Field(at).type, value_->items[at].items.back());
  }
  // Of an array of numbers; empty where it is not there.
  const std::vector<double>& Numbers(absl::string_view name) const {
    static const auto& none = *new std::vector<double>;
    const CdrValue* found = Find(name);
    return found == nullptr ? none : found->numbers;
  }
  absl::StatusOr<std::vector<std::string>> Names(absl::string_view name) const {
    const CdrValue* found = Find(name);
    if (found == nullptr) return Missing(name, "list of names");
    std::set<std::string> seen;
    for (const std::string& text : found->texts) {
      if (!seen.insert(text).second)
        return absl::InvalidArgumentError(absl::StrCat("field ", name, " has '", text, "' twice"));
    }
    return found->texts;
  }

 private:
  const std::vector<RosField>& Fields() const { return schema_->types()[type_].fields; }
  const RosField& Field(size_t at) const { return Fields()[at]; }
  size_t IndexOf(absl::string_view name) const {
    const auto found = std::find_if(Fields().begin(), Fields().end(),
                                    [&](const RosField& field) { return field.name == name; });
    return static_cast<size_t>(found - Fields().begin());
  }
  absl::Status Missing(absl::string_view name, absl::string_view what) const {
    return absl::InvalidArgumentError(
        absl::StrCat("field ", name, " of ", schema_->types()[type_].name, " is no ", what));
  }

  const RosSchema* schema_;
  size_t type_;
  const CdrValue* value_;
};

absl::Status TakeStamp(const Node& root, JointMessage* message) {
  RS_ASSIGN_OR_RETURN(const Node header, root.Struct("header"));
  RS_ASSIGN_OR_RETURN(const Node stamp, header.Struct("stamp"));
  const std::vector<double>& sec = stamp.Numbers("sec");
  const std::vector<double>& nanosec = stamp.Numbers("nanosec");
  if (sec.size() != 1 || nanosec.size() != 1)
    return absl::InvalidArgumentError("field header.stamp has no sec and nanosec");
  // A schema may have other types there than ROS 2's int32 and uint32.
  if (!(std::abs(sec[0]) <= 0x1p31))
    return absl::InvalidArgumentError(
        absl::StrCat("field header.stamp.sec is ", sec[0], ", must fit in 32 bits"));
  if (!(nanosec[0] >= 0 && nanosec[0] < kNanoseconds))
    return absl::InvalidArgumentError(absl::StrCat("field header.stamp.nanosec is ", nanosec[0],
                                                   ", must be 0 to ", kNanoseconds - 1));
  message->stamp_ns =
      static_cast<int64_t>(sec[0]) * kNanoseconds + static_cast<int64_t>(nanosec[0]);
  message->stamped = message->stamp_ns != 0;
  return absl::OkStatus();
}

// An array is empty or as long as the names.
absl::Status Append(const std::vector<std::string>& names, const Node& node,
                    absl::string_view field, JointQuantity quantity, JointMessage* message) {
  const std::vector<double>& values = node.Numbers(field);
  if (!values.empty() && values.size() != names.size())
    return absl::InvalidArgumentError(absl::StrCat("field ", field, " has ", values.size(),
                                                   " numbers for ", names.size(), " names"));
  for (size_t i = 0; i < values.size(); ++i)
    message->readings.push_back({names[i], quantity, values[i]});
  return absl::OkStatus();
}

// The first of these points that is there and holds positions.
absl::StatusOr<Node> FirstPoint(const Node& root, absl::string_view present,
                                absl::string_view old) {
  const absl::StatusOr<Node> point = root.Struct(present);
  if (point.ok() && !point->Numbers("positions").empty()) return point;
  const absl::StatusOr<Node> other = root.Struct(old);
  if (point.ok() && (!other.ok() || other->Numbers("positions").empty())) return point;
  return other;
}

absl::Status ReadControllerState(const Node& root, JointMessage* message) {
  RS_RETURN_IF_ERROR(TakeStamp(root, message));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, root.Names("joint_names"));
  RS_ASSIGN_OR_RETURN(const Node measured, FirstPoint(root, "feedback", "actual"));
  RS_ASSIGN_OR_RETURN(const Node asked, FirstPoint(root, "reference", "desired"));
  RS_RETURN_IF_ERROR(Append(names, measured, "positions", JointQuantity::kPosition, message));
  RS_RETURN_IF_ERROR(Append(names, measured, "velocities", JointQuantity::kVelocity, message));
  RS_RETURN_IF_ERROR(Append(names, measured, "effort", JointQuantity::kEffort, message));
  return Append(names, asked, "positions", JointQuantity::kCommand, message);
}

constexpr char kTime[] = "int32 sec\nuint32 nanosec\n";
constexpr char kHeader[] = "builtin_interfaces/Time stamp\nstring frame_id\n";
constexpr char kPoint[] =
    "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
    "builtin_interfaces/Duration time_from_start\n";

// A definition with the types that it needs behind it.
std::string With(std::string text, std::vector<std::pair<const char*, const char*>> needed) {
  for (const auto& [name, definition] : needed)
    absl::StrAppend(&text, std::string(80, '='), "\nMSG: ", name, "\n", definition);
  return text;
}

// The layouts that the tags of control_msgs have had, the newest first: 5.3 on, 5.0 to 5.2, 4.4 to
// 4.8 (Humble), 4.0 to 4.3, up to 3.0.
std::vector<std::string> ControllerStates() {
  constexpr char kNow[] = "POINTreference\nPOINTfeedback\nPOINTerror\nPOINToutput\n";
  constexpr char kOld[] = "POINTdesired\nPOINTactual\nPOINTerror\n";
  const std::string both = absl::StrCat(kNow, "POINTdesired\nPOINTactual\n");
  const auto layout = [](absl::string_view points, bool multi, const char* behind) {
    std::string text = absl::StrCat(
        "std_msgs/Header header\nstring[] joint_names\n",
        absl::StrReplaceAll(points, {{"POINT", "trajectory_msgs/JointTrajectoryPoint "}}));
    if (multi)
      absl::StrAppend(
          &text, "string[] multi_dof_joint_names\n",
          absl::StrReplaceAll(
              points, {{"POINT", "trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_"}}));
    return With(
        text + behind,
        {{"std_msgs/Header", kHeader},
         {"builtin_interfaces/Time", kTime},
         {"builtin_interfaces/Duration", kTime},
         {"trajectory_msgs/JointTrajectoryPoint", kPoint},
         {"trajectory_msgs/MultiDOFJointTrajectoryPoint",
          "geometry_msgs/Transform[] transforms\ngeometry_msgs/Twist[] velocities\n"
          "geometry_msgs/Twist[] accelerations\n"
          "builtin_interfaces/Duration time_from_start\n"},
         {"geometry_msgs/Transform",
          "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"},
         {"geometry_msgs/Twist", "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"},
         {"geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"},
         {"geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"}});
  };
  return {layout(kNow, true, "float64 speed_scaling_factor\n"), layout(kNow, true, ""),
          layout(both, true, ""), layout(kOld, true, ""), layout(kOld, false, "")};
}

}  // namespace

JointMessageKind KindOfType(absl::string_view type) {
  const std::string plain = absl::StrReplaceAll(type, {{"/msg/", "/"}});
  if (plain == "sensor_msgs/JointState") return JointMessageKind::kJointState;
  if (plain == "control_msgs/JointTrajectoryControllerState")
    return JointMessageKind::kControllerState;
  if (plain == "trajectory_msgs/JointTrajectory") return JointMessageKind::kTrajectory;
  if (plain == "std_msgs/Float64MultiArray") return JointMessageKind::kArray;
  return JointMessageKind::kNone;
}

bool IsCommandTopic(absl::string_view topic) {
  const size_t slash = topic.rfind('/');
  if (slash != absl::string_view::npos) topic.remove_prefix(slash + 1);
  const std::vector<absl::string_view> words = absl::StrSplit(topic, '_');
  return std::any_of(words.begin(), words.end(), [](absl::string_view word) {
    return word == "command" || word == "commands" || word == "cmd" || word == "desired" ||
           word == "target";
  });
}

RecordedChannel DescribeTopic(const std::string& topic, const std::string& type) {
  RecordedChannel channel{topic, type, "", "rad", "REP 103 (metres at a slide)", "", true};
  switch (KindOfType(type)) {
    case JointMessageKind::kNone:
      return {topic, type, "", "", "", "", false};
    case JointMessageKind::kJointState:
      channel.caution =
          IsCommandTopic(topic)
              ? "commands by the topic's name; what the hardware clips it does not say"
              : "effort is what the driver puts there: torque, current, or a share of either";
      break;
    case JointMessageKind::kControllerState:
      channel.caution =
          "a reference is what the controller aims at now; the hardware may clip what it is sent";
      break;
    case JointMessageKind::kTrajectory:
      channel.caution = "a trajectory is a request to a controller, not a command to a servo";
      break;
    case JointMessageKind::kArray:
      channel.unit = "";
      channel.unit_because = "the message says neither joints nor units";
      channel.caution =
          "commands of joints that the message does not name, stamped by the recorder alone";
      break;
  }
  return channel;
}

absl::StatusOr<JointMessage> ReadJointMessage(JointMessageKind kind, const RosSchema& schema,
                                              const CdrValue& value) {
  const Node root(schema, 0, value);
  JointMessage message;
  if (kind == JointMessageKind::kControllerState) {
    RS_RETURN_IF_ERROR(ReadControllerState(root, &message));
  } else if (kind == JointMessageKind::kJointState) {
    RS_RETURN_IF_ERROR(TakeStamp(root, &message));
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, root.Names("name"));
    RS_RETURN_IF_ERROR(Append(names, root, "position", JointQuantity::kPosition, &message));
    RS_RETURN_IF_ERROR(Append(names, root, "velocity", JointQuantity::kVelocity, &message));
    RS_RETURN_IF_ERROR(Append(names, root, "effort", JointQuantity::kEffort, &message));
  } else if (kind == JointMessageKind::kTrajectory) {
    RS_RETURN_IF_ERROR(TakeStamp(root, &message));
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, root.Names("joint_names"));
    RS_ASSIGN_OR_RETURN(const Node point, root.Last("points"));
    RS_RETURN_IF_ERROR(Append(names, point, "positions", JointQuantity::kGoal, &message));
  } else if (kind == JointMessageKind::kArray) {
    if (root.Find("data") == nullptr)
      return absl::InvalidArgumentError("field data of std_msgs/Float64MultiArray is missing");
    const std::vector<double>& data = root.Numbers("data");
    for (size_t i = 0; i < data.size(); ++i)
      message.readings.push_back({absl::StrCat("[", i, "]"), JointQuantity::kCommand, data[i]});
  }
  return message;
}

std::vector<std::string> KnownDefinitions(JointMessageKind kind) {
  switch (kind) {
    case JointMessageKind::kNone:
      return {};
    case JointMessageKind::kJointState:
      return {
          With("std_msgs/Header header\nstring[] name\nfloat64[] position\n"
               "float64[] velocity\nfloat64[] effort\n",
               {{"std_msgs/Header", kHeader}, {"builtin_interfaces/Time", kTime}})};
    case JointMessageKind::kControllerState:
      return ControllerStates();
    case JointMessageKind::kTrajectory:
      return {
          With("std_msgs/Header header\nstring[] joint_names\n"
               "trajectory_msgs/JointTrajectoryPoint[] points\n",
               {{"std_msgs/Header", kHeader},
                {"builtin_interfaces/Time", kTime},
                {"builtin_interfaces/Duration", kTime},
                {"trajectory_msgs/JointTrajectoryPoint", kPoint}})};
    case JointMessageKind::kArray:
      return {
          With("std_msgs/MultiArrayLayout layout\nfloat64[] data\n",
               {{"std_msgs/MultiArrayLayout",
                 "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset\n"},
                {"std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"}})};
  }
  return {};
}

}  // namespace robostress
