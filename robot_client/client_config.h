#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"
#include "robot_client/control/control_loop.h"
#include "robot_client/feedback_assembler.h"
#include "robot_client/policy_connection.h"
#include "robot_client/realtime.h"

namespace robostress {

// Everything that a run of the client is made of; this struct is DIR/config.yaml.
struct ClientConfig {
  // can:can0, udp:GROUP:PORT, bridge:unix:SOCKET, or rehearse: no arm at all
  std::string bus = "rehearse";
  std::string robot;                 // robot file of an arm behind a bridge
  std::string instruction;           // what the policy is told
  std::vector<std::string> cameras;  // NAME=SOURCE in the policy's order, see MakeCamera
  int task = 0;                      // index in the experiment; one run is one task, one session
  int first_episode = 0;
  int episodes = 25;
  double episode_s = 60;             // [s] of RUN until an episode ends by itself
  std::vector<double> home;          // joints [rad], opening [m]; empty: there is no such pose
  double home_velocity = 0.6;        // [rad/s] of the fastest joint on the way home
  double jog_velocity = 0.2;         // [rad/s]
  bool slow_first = true;            // a motion is played at a quarter of its speed first
  int collision_level = -1;          // of the arm's own protection, 0 (off) .. 8; -1: as it is
  bool record_required = true;       // false: the arm may move on when the recording has failed
  bool record_pictures = false;      // keep what the policy is shown
  std::vector<std::string> without;  // guards that are given up, by the names of their options
  PolicyConnectionOptions policy;
  ControlOptions control;
  FeedbackOptions feedback;
  RealtimeOptions realtime;

  template <class V>
  void Visit(V& v) {
    v.Field("bus", bus, "can:can0, udp:GROUP:PORT, bridge:unix:SOCKET, or rehearse: no arm");
    v.Late("robot", robot, std::string(), "robot file of an arm behind a bridge");
    v.Field("instruction", instruction, "what the policy is told");
    v.Field("cameras", cameras, "NAME=SOURCE in the order that the policy wants");
    v.Field("task", task, "index in the experiment; one run, one task, one adaptation");
    v.Field("first_episode", first_episode, "index of the first episode");
    v.Field("episodes", episodes, "consecutive episodes; adaptation is kept over them");
    v.Field("episode_s", episode_s, "most time of an episode [s]");
    v.Field("home", home, "pose of `home`: the joints [rad], then the opening [m]; empty: none");
    v.Field("home_velocity", home_velocity, "most speed of a joint on the way home [rad/s]");
    v.Field("jog_velocity", jog_velocity, "most speed of a joint that is jogged [rad/s]");
    v.Field("slow_first", slow_first,
            "a motion must have been played slowly in this run before it is played");
    v.Field("collision_level", collision_level,
            "the arm's own collision protection, 0 (off) to 8, written to it; -1: as it is");
    v.Field("record_required", record_required,
            "false: the arm may move on unrecorded, on a full disk for one");
    v.Late("record_pictures", record_pictures, false,
           "keep the pictures that the policy is shown, as PNG");
    v.Field("without", without, "guards that are given up: they may have values out of range");
    v.Section("policy", policy, "the policy server and its session");
    v.Section("control", control, "the control loop");
    v.Section("feedback", feedback, "what is reported to the server");
    v.Section("realtime", realtime, "priority of the control thread");
  }
};

// Checks what can be checked without arm, server and cameras; names key, value and remedy.
absl::Status CheckConfig(const ClientConfig& config);

// A camera from `NAME=SOURCE[,fault=KIND[:AMOUNT][@SECONDS]]`, the fault from SECONDS on:
//   base=v4l2:/dev/v4l/by-id/...[@640x480]   a camera
//   wrist=files:DIR                          *.ppm of a folder, over and over
//   base=mapped:FILE                         pictures of an emulator on this machine
//   base=synthetic                           a moving pattern
absl::StatusOr<std::unique_ptr<FrameSource>> MakeCamera(const std::string& text, Clock* clock);

// The arm of config.bus is behind a driver process, which config.robot describes.
bool IsBridge(const ClientConfig& config);
// It may be one that can hurt somebody.
absl::StatusOr<bool> IsReal(const ClientConfig& config);
// The axes of its arm: of the robot file behind a bridge, else a Piper's.
absl::StatusOr<ArmAxes> AxesOf(const ClientConfig& config);
// What rigs call its joints, from the base on: as the model of the robot file, or as the driver; of
// a Piper piper_joint1 and on.
absl::StatusOr<std::vector<std::string>> RigNamesOf(const ClientConfig& config);
// The robot file's word in place of defaults: rate, home, control.press, and with a model
// control.workspace. Nothing for an arm that is no bridge.
absl::Status TakeRobotFile(ClientConfig& config);

// The arm of config.bus, not connected.
absl::StatusOr<std::unique_ptr<RobotArm>> MakeArm(const ClientConfig& config, Clock* clock);
// What is known of its mechanics; after Connect. Null: nothing, then nothing is watched that needs
// a model.
std::unique_ptr<ArmModel> MakeModel(const ClientConfig& config, const RobotArm& arm);

}  // namespace robostress
