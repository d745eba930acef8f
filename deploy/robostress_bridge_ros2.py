#!/usr/bin/env python3
"""Gives an arm of ros2_control to robot_client, from a sourced ROS 2 environment.

    python3 robostress_bridge_ros2.py --socket /tmp/arm --joints panda_joint1,panda_joint2 \\
      --command-topic /joint_trajectory_controller/joint_trajectory
    robot_client --arm bridge:unix:/tmp/arm --robot my_arm.yaml ...

States are sensor_msgs/JointState of --state-topic, joints by their names, whatever their order.
Commands are trajectory_msgs/JointTrajectory of one point (joint_trajectory_controller), or, with
--forward, std_msgs/Float64MultiArray in the order of --joints, which must be that of the
forward_command_controller's own list. Radians and metres, as ROS has them.

A state is as old as its stamp says; one with the stamp before, or an older one, is none. Where the
robot's clock is not this machine's, synchronise them, or say --other-clock: then states count from
when they come. Nothing is sent while nobody listens to --command-topic, and that is an error: is the
controller loaded? Whether it is active ROS does not say there.

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

OTHER_CLOCK_S = 3600.0  # first stamps that are further from now are another clock's: of a simulation
LATE_S, AHEAD_S = 1.0, 0.02  # older or newer stamps of this clock are worth a word


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
        self.last_stamp = 0
        self.shares_clock = False if options.other_clock else None  # None: the first stamp decides
        self.complained = -math.inf
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
        measured = self.measured_at(message.header.stamp, arrived)
        if measured is None:
            return
        self.newest = (
            measured,
            [message.position[i] for i in order],
            self.row(message.velocity, message.name, order, self.measures_velocity),
            self.row(message.effort, message.name, order, self.measures_effort),
            0,
        )

    def measured_at(self, header_stamp, arrived):
        """When a message was measured [ns, monotonic]. None: it is no newer than the one before."""
        stamp = header_stamp.sec * 10**9 + header_stamp.nanosec
        if stamp == 0:
            return arrived
        if stamp <= self.last_stamp:
            self.complain("a JointState came again, or its stamp went back: left out; after a simulation's reset "
                          "start this driver again")
            return None
        age = self.node.get_clock().now().nanoseconds - stamp
        if self.shares_clock is None:
            self.shares_clock = abs(age) < OTHER_CLOCK_S * 1e9
        if self.shares_clock and not -AHEAD_S * 1e9 < age < LATE_S * 1e9:
            self.complain(f"a JointState is {age / 1e9:.2f} s old by its stamp: is its clock right? synchronise it, "
                          "or say --other-clock")
        if self.shares_clock and age < -LATE_S * 1e9:
            return None  # and its stamp is not one that others have to be newer than
        self.last_stamp = stamp
        return arrived - max(age, 0) if self.shares_clock else arrived

    def complain(self, text):
        now = time.monotonic()
        if now - self.complained >= 1:
            self.complained = now
            logging.warning("%s", text)

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
        if self.publisher.get_subscription_count() == 0:
            raise RuntimeError(f"nobody listens to {self.robot}: is the controller loaded, and the topic its own?")
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
    parser.add_argument("--other-clock", action="store_true",
                        help="stamps are of a clock that is not this machine's: states count from when they come")
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
