#!/usr/bin/env python3
"""Gives an arm of ros2_control to robot_client, from a sourced ROS 2 environment.

    python3 robostress_bridge_ros2.py --socket /tmp/arm --joints panda_joint1,panda_joint2 \\
      --command-topic /joint_trajectory_controller/joint_trajectory
    robot_client --arm bridge:unix:/tmp/arm --robot my_arm.yaml ...

States are sensor_msgs/JointState of --state-topic, joints by their names, whatever their order.
Commands are trajectory_msgs/JointTrajectory of one point (joint_trajectory_controller), or, with
--forward, std_msgs/Float64MultiArray in the order of --joints, which must be that of the
forward_command_controller's own list. Radians and metres, as ROS has them.

Both controllers keep their last target, and have no stop and no way to take the power off over a
topic: holding sends the measured positions, and the gripper's last target. The power stays what the
hardware makes of it. Efforts are passed on where --efforts says that they are newton metres.
"""

import argparse
import logging
import math
import os
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import robostress_bridge as bridge

import rclpy
from sensor_msgs.msg import JointState

MOST_AGE_S = 1.0  # of a header's stamp: older or of a time to come, it is another clock's


class RosArm(bridge.Arm):
    """The joints of one JointState topic and one controller."""

    driver = "robostress_bridge_ros2"

    def __init__(self, node, options):
        self.node, self.simulated = node, options.simulated
        self.axes = options.joints.split(",")
        self.robot = options.command_topic
        self.measures_velocity, self.measures_effort = options.velocities, options.efforts
        self.reach_s = options.reach_s
        self.newest = None
        node.create_subscription(JointState, options.state_topic, self.on_state, 10)
        if options.forward:
            from std_msgs.msg import Float64MultiArray as Message
        else:
            from trajectory_msgs.msg import JointTrajectory as Message
        self.message = Message
        self.publisher = node.create_publisher(Message, options.command_topic, 10)
        self.make = self.forward if options.forward else self.trajectory

    def on_state(self, message):
        """The newest message with all joints; a message may name them in any order, or some."""
        arrived = time.monotonic_ns()
        places = {name: i for i, name in enumerate(message.name)}
        if any(name not in places for name in self.axes) or len(message.position) != len(message.name):
            return
        order = [places[name] for name in self.axes]
        stamp = message.header.stamp
        age = self.node.get_clock().now().nanoseconds - (stamp.sec * 10**9 + stamp.nanosec)
        known = 0 <= age < MOST_AGE_S * 1e9
        self.newest = (
            arrived - (age if known else 0),
            [message.position[i] for i in order],
            self.row(message.velocity, message.name, order, self.measures_velocity),
            self.row(message.effort, message.name, order, self.measures_effort),
            0,
        )

    @staticmethod
    def row(values, names, order, wanted):
        """Missing values are NaN where they were promised, so that the client sees it."""
        if not wanted:
            return None
        return [values[i] if len(values) == len(names) else math.nan for i in order]

    def read(self):
        for _ in range(64):  # what has come, and no more
            before = self.newest
            rclpy.spin_once(self.node, timeout_sec=0)
            if self.newest is before:
                break
        if self.newest is None:
            raise RuntimeError(f"no JointState with {self.axes} has come")
        return self.newest

    def trajectory(self, targets):
        from trajectory_msgs.msg import JointTrajectoryPoint

        message, point = self.message(), JointTrajectoryPoint()
        message.joint_names = list(self.axes)
        point.positions = list(targets)
        point.time_from_start.sec = int(self.reach_s)
        point.time_from_start.nanosec = int(self.reach_s % 1 * 1e9)
        message.points = [point]
        return message  # its stamp stays 0: begin now

    def forward(self, targets):
        message = self.message()
        message.data = list(targets)
        return message

    def move(self, targets, gripper_effort):
        self.publisher.publish(self.make(targets))

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown()


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    bridge.add_options(parser)
    parser.add_argument("--joints", required=True, help="names, comma between, the gripper last")
    parser.add_argument("--state-topic", default="/joint_states")
    parser.add_argument("--command-topic", required=True)
    parser.add_argument("--forward", action="store_true", help="Float64MultiArray instead of JointTrajectory")
    parser.add_argument("--reach-s", type=float, default=0.05,
                        help="time in which a point is to be reached [s]; about a control period")
    parser.add_argument("--velocities", action="store_true", help="JointState has velocities")
    parser.add_argument("--efforts", action="store_true", help="JointState has efforts, in Nm")
    parser.add_argument("--simulated", action="store_true", help="nobody can be hurt by this arm")
    options = parser.parse_args(arguments)
    if not 0.001 <= options.reach_s <= 1:
        parser.error("--reach-s must be 0.001 to 1")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    rclpy.init()
    bridge.serve(RosArm(rclpy.create_node("robostress_bridge"), options), options)


if __name__ == "__main__":
    main()
