"""A bag as a laboratory has it, of a rig's CSV log: lab_bag.py LOG.csv BAG

BAG becomes a rosbag2 folder (MCAP) with /joint_states (sensor_msgs/JointState) and /controller/state
(control_msgs/JointTrajectoryControllerState: reference and feedback), as ros2_control publishes them; the order of the
joints is turned round, as it may be.
"""

import csv
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore, get_types_from_msg

STATE = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
"""


def main():
    rows = list(csv.DictReader(open(sys.argv[1])))
    joints = [name[len("q_cmd_"):] for name in rows[0] if name.startswith("q_cmd_")][::-1]
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    store.register(get_types_from_msg(STATE, kind))
    types = store.types
    none = np.array([], dtype=np.float64)

    def header(t):
        sec = int(t)
        return types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=sec, nanosec=round((t - sec) * 1e9)), frame_id="")

    def point(values):
        return types["trajectory_msgs/msg/JointTrajectoryPoint"](
            positions=values, velocities=none, accelerations=none, effort=none,
            time_from_start=types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0))

    with Writer(Path(sys.argv[2]), version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        states = bag.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        controller = bag.add_connection("/controller/state", kind, typestore=store)
        for row in rows:
            t = 1000 + float(row["t"])
            q = np.array([float(row[f"q_{joint}"]) for joint in joints])
            command = np.array([float(row[f"q_cmd_{joint}"]) for joint in joints])
            message = types["sensor_msgs/msg/JointState"](
                header=header(t), name=joints, position=q, velocity=none, effort=none)
            stamp = round(t * 1e9)
            bag.write(states, stamp, store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
            message = types[kind](header=header(t), joint_names=joints, reference=point(command), feedback=point(q),
                                  error=point(none), output=point(none))
            bag.write(controller, stamp, store.serialize_cdr(message, kind))


main()
