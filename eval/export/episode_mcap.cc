#include "eval/export/episode_mcap.h"

#include <cmath>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/recordings/cdr_encoder.h"
#include "common/recordings/joint_messages.h"
#include "common/recordings/mcap_writer.h"
#include "common/status_macros.h"
#include "eval/export/mcap_topics.h"

namespace robostress {
namespace {

using Step = EpisodeRecording::Step;

constexpr int64_t kSecond = 1'000'000'000;  // [ns]
constexpr char kFrame[] = "base";
constexpr char kPose[] = "geometry_msgs/Pose pose\n";

McapSchema PoseStamped() {
  return StampedSchema(
      "geometry_msgs/msg/PoseStamped", kPose,
      absl::StrCat(
          RosDefinition("geometry_msgs/Pose",
                        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"),
          RosDefinition("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
          RosDefinition("geometry_msgs/Quaternion",
                        "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n")));
}

// A topic of named numbers: a field float64 each, in the order of the names.
struct NumbersTopic {
  const char* name;
  const char* type;
  std::vector<std::string> fields;
  Eigen::VectorXd (*of)(const Step&);
};

const std::vector<NumbersTopic>& NumbersTopics() {
  static const auto& topics = *new std::vector<NumbersTopic>([] {
    const std::vector<std::string> joints = {"j1", "j2", "j3", "j4", "j5", "j6", "j7"};
    const std::vector<std::string> action = {"x", "y", "z", "rx", "ry", "rz", "gripper"};
    using V = Eigen::VectorXd;
    return std::vector<NumbersTopic>{
        {"/joints/position", "Joints", joints, [](const Step& s) -> V { return s.before.q; }},
        {"/joints/velocity", "Joints", joints, [](const Step& s) -> V { return s.before.dq; }},
        {"/gripper",
         "Gripper",
         {"opening"},
         [](const Step& s) -> V { return V::Constant(1, s.before.gripper); }},
        {"/observation/state",
         "State",
         {"x", "y", "z", "rx", "ry", "rz", "finger1", "finger2"},
         [](const Step& s) -> V { return s.proprioception.cast<double>(); }},
        {"/action/commanded", "Action", action,
         [](const Step& s) -> V { return s.commanded.cast<double>(); }},
        {"/action/sent", "Action", action,
         [](const Step& s) -> V { return s.sent.cast<double>(); }},
        {"/action/measured", "Action", action,
         [](const Step& s) -> V { return s.measured.cast<double>(); }}};
  }());
  return topics;
}

// The file's topics, and a step's messages on them.
class EpisodeTopics {
 public:
  EpisodeTopics(const EpisodeRecording& recording, McapWriter* file) : file_(file), topics_(file) {
    joint_states_ =
        topics_.Add("/joint_states", {"sensor_msgs/msg/JointState", "ros2msg",
                                      KnownDefinitions(JointMessageKind::kJointState)[0]});
    tool_pose_ = topics_.Add("/tool_pose", PoseStamped());
    for (const NumbersTopic& topic : NumbersTopics()) {
      numbers_.push_back(topics_.Add(topic.name, NumbersSchema(topic.type, topic.fields)));
    }
    for (const std::string& camera : recording.cameras)
      cameras_.push_back(topics_.Add("/camera/" + camera, CompressedImageSchema()));
  }

  absl::Status Write(const EpisodeRecording& recording, size_t t) {
    const Step& step = recording.steps[t];
    stamp_ns_ = kSecond + std::llround(static_cast<double>(t) * kSecond / recording.rate_hz);
    RS_RETURN_IF_ERROR(Send(joint_states_, Begin()
                                               .Texts({"J1", "J2", "J3", "J4", "J5", "J6", "J7"})
                                               .Numbers(step.before.q)
                                               .Numbers(step.before.dq)
                                               .Numbers(std::vector<double>())));
    const Eigen::Vector3d& p = step.before.tool.p_base_tool;
    const Eigen::Quaterniond& q = step.before.tool.q_base_tool;
    CdrEncoder pose = Begin();
    for (const double value : {p.x(), p.y(), p.z(), q.x(), q.y(), q.z(), q.w()}) pose.Number(value);
    RS_RETURN_IF_ERROR(Send(tool_pose_, pose));
    for (size_t i = 0; i < numbers_.size(); ++i) {
      CdrEncoder message = Begin();
      for (const double value : NumbersTopics()[i].of(step)) message.Number(value);
      RS_RETURN_IF_ERROR(Send(numbers_[i], message));
    }
    for (size_t i = 0; i < cameras_.size(); ++i)
      RS_RETURN_IF_ERROR(Send(cameras_[i], Begin().Text("png").Bytes(recording.pictures[i][t])));
    return absl::OkStatus();
  }

 private:
  CdrEncoder Begin() const { return CdrEncoder().Header(stamp_ns_, kFrame); }
  absl::Status Send(uint16_t channel, const CdrEncoder& message) {
    return file_->Write(channel, static_cast<uint64_t>(stamp_ns_), message.Message());
  }

  McapWriter* file_;
  McapTopics topics_;
  uint16_t joint_states_ = 0, tool_pose_ = 0;
  std::vector<uint16_t> numbers_, cameras_;
  int64_t stamp_ns_ = 0;
};

}  // namespace

absl::Status WriteEpisodeMcap(const EpisodeRecording& recording,
                              const std::map<std::string, std::string>& origin,
                              const std::string& path) {
  if (!(recording.rate_hz >= 1e-3 && recording.rate_hz <= 1e6))
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": the recording's rate_hz is ", recording.rate_hz, ", must be 0.001 to 1000000"));
  RS_ASSIGN_OR_RETURN(McapWriter file, McapWriter::Create(path, "ros2"));
  EpisodeTopics topics(recording, &file);
  for (size_t t = 0; t < recording.steps.size(); ++t)
    RS_RETURN_IF_ERROR(topics.Write(recording, t));
  RS_RETURN_IF_ERROR(file.AddMetadata("robostress", origin));
  return file.Publish();
}

}  // namespace robostress
