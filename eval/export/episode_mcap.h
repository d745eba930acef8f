#pragma once

#include <map>
#include <string>

#include "absl/status/status.h"
#include "common/records/episode_recording.h"

namespace robostress {

// An episode as one MCAP file (common/recordings/mcap_writer.h) that Foxglove and rosbag2's tools
// open: messages of ROS 2 in CDR, their definitions in the file. ROS because its image and joint
// messages are what panels look for, and what this project's own readers read. Where ROS has no
// message with named numbers, the file brings one of float64 fields, so that a plot asks for
// /action/sent.x by name.
//
//   topic                   type
//   /joint_states           sensor_msgs/msg/JointState    J1 to J7: [rad], [rad/s]; no effort
//   /joints/position        robostress_msgs/msg/Joints    the same as fields j1 .. j7 [rad]
//   /joints/velocity        robostress_msgs/msg/Joints    [rad/s]
//   /tool_pose              geometry_msgs/msg/PoseStamped tool in the frame "base" [m]
//   /gripper                robostress_msgs/msg/Gripper   opening [m]
//   /observation/state      robostress_msgs/msg/State     x y z rx ry rz finger1 finger2, what the
//                           policy was given [m], [rad], [m]
//   /action/commanded       robostress_msgs/msg/Action    x y z rx ry rz gripper, normalised
//   /action/sent, /action/measured                        the same (episode_recording.h)
//   /camera/NAME            sensor_msgs/msg/CompressedImage PNG, as recorded
//
// Every topic has a message a control step. Step t is stamped 1 s + t / rate_hz, headers and log
// alike: in simulated time, from 1 s because ROS takes a stamp of 0 for none. A measured action
// has the stamp of the step that it is of, so that it stands over what was sent. The metadata
// record "robostress" holds `origin`. Memory is the recording's and a chunk's.
absl::Status WriteEpisodeMcap(const EpisodeRecording& recording,
                              const std::map<std::string, std::string>& origin,
                              const std::string& path);

}  // namespace robostress
