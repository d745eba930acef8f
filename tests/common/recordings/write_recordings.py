"""Recordings as other people's libraries write them: write_recordings.py FOLDER

Leaves recordings and expected.json, which says of each what is in it: rows of [stamp or time in ns,
{"position NAME": value}]. large_bag.py writes a long one.
"""

import glob
import json
import os
import sqlite3
import sys
from contextlib import closing

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

RULE = "=" * 80 + "\n"
JOINT_STATE = ("std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"
               + RULE + "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
               + RULE + "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n")
# The layouts of control_msgs' tags: points, whether there are those of many degrees of freedom, what stands behind.
LAYOUTS = {
    "v6": (["reference", "feedback", "error", "output"], True, ["float64 speed_scaling_factor"]),
    "v5": (["reference", "feedback", "error", "output"], True, []),
    "humble": (["reference", "feedback", "error", "output", "desired", "actual"], True, []),
    "v4": (["desired", "actual", "error"], True, []),
    "galactic": (["desired", "actual", "error"], False, []),
}
START = 1_700_000_000_000_000_000
ROWS = 300


def motion(i):
    """Names, positions, velocities and efforts of row i; the order of the names changes."""
    names = ["shoulder", "elbow", "wrist"]
    q = [np.sin(0.03 * i + k) * (k + 1) / 3 for k in range(3)]
    dq = [0.03 * np.cos(0.03 * i + k) * 100 for k in range(3)]
    tau = [-float(x) * 2.7 for x in q]
    order = [0, 1, 2] if i % 3 else [2, 0, 1]
    return [[values[k] for k in order] for values in (names, q, dq, tau)]


def expected_row(i):
    names, q, dq, tau = motion(i)
    values = {}
    for what, numbers in (("position", q), ("velocity", dq), ("effort", tau)):
        values.update({f"{what} {name}": float(x) for name, x in zip(names, numbers)})
    return [START + i * 10_000_000, values]


def write_mcap(path, compression):
    with open(path, "wb") as file:
        writer = McapWriter(file, chunk_size=20_000, compression=compression)
        schema = writer.register_msgdef("sensor_msgs/msg/JointState", JOINT_STATE)
        for i in range(ROWS):
            names, q, dq, tau = motion(i)
            stamp = START + i * 10_000_000
            message = {"header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "base"},
                       "name": names, "position": q, "velocity": dq, "effort": tau}
            writer.write_message("/joint_states", schema, message, stamp + 123, stamp)
        writer.finish()
    return [expected_row(i) for i in range(ROWS)]


def write_rosbag(path, plugin, version, compression):
    store = get_typestore(Stores.ROS2_HUMBLE)
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    state = store.types["sensor_msgs/msg/JointState"]
    writer = Writer(path, version=version, storage_plugin=plugin)
    if compression:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", state.__msgtype__, typestore=store)
        for i in range(ROWS):
            names, q, dq, tau = motion(i)
            stamp = START + i * 10_000_000
            message = state(header=header(stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="x"),
                            name=names, position=np.array(q), velocity=np.array(dq), effort=np.array(tau))
            writer.write(connection, stamp + 5, store.serialize_cdr(message, state.__msgtype__))
    return [expected_row(i) for i in range(ROWS)]


def write_controller_state(path, layout, plugin):
    store = get_typestore(Stores.ROS2_HUMBLE)
    name = "control_msgs/msg/JointTrajectoryControllerState"
    lines = ["std_msgs/Header header", "string[] joint_names"]
    points, many, behind = LAYOUTS[layout]
    lines += [f"trajectory_msgs/JointTrajectoryPoint {point}" for point in points]
    if many:
        lines += ["string[] multi_dof_joint_names"]
        lines += [f"trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{point}" for point in points]
    lines += behind
    store.register(get_types_from_msg("\n".join(lines) + "\n", name))
    types = store.types
    time, duration = types["builtin_interfaces/msg/Time"], types["builtin_interfaces/msg/Duration"]
    state, point = types[name], types["trajectory_msgs/msg/JointTrajectoryPoint"]
    multi = types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    none = np.array([], dtype=np.float64)

    def at(q, dq=none):
        return point(positions=np.array(q), velocities=np.array(dq), accelerations=none, effort=none,
                     time_from_start=duration(sec=0, nanosec=0))

    rows = []
    version = 8 if plugin is StoragePlugin.SQLITE3 else 9
    with Writer(path, version=version, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/controller/state", name, typestore=store)
        for i in range(ROWS):
            stamp, q, command = START + i * 10_000_000, [np.sin(0.1 * i), 0.2 * i], [np.sin(0.1 * i + 0.05), 0.2 * i + 1]
            at_points = {"reference": at(command), "desired": at(command), "feedback": at(q, [0.5, -0.25]),
                         "actual": at(q, [0.5, -0.25]), "error": at(none), "output": at(none)}
            fields = {key: at_points[key] for key in points}
            if many:
                fields["multi_dof_joint_names"] = []
                fields.update({f"multi_dof_{key}": multi(transforms=[], velocities=[], accelerations=[],
                                                         time_from_start=duration(sec=0, nanosec=0))
                               for key in points})
            if behind:
                fields["speed_scaling_factor"] = 1.0
            header = types["std_msgs/msg/Header"](stamp=time(sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="")
            message = state(header=header, joint_names=["a", "b"], **fields)
            writer.write(connection, stamp, store.serialize_cdr(message, name))
            rows.append([stamp, {"position a": float(q[0]), "position b": q[1], "velocity a": 0.5, "velocity b": -0.25,
                                 "command a": float(command[0]), "command b": command[1]}])
    if plugin is StoragePlugin.SQLITE3:  # recorders up to Humble write no definitions: the reader's own have to fit
        for file in glob.glob(os.path.join(path, "*.db3")):
            with closing(sqlite3.connect(file)) as data, data:
                data.execute("DROP TABLE message_definitions")
    return rows


def write_lerobot(path, version, **options):
    """Two episodes; v2.1: a file each, v3.0: a group of rows each in one file."""
    names = ["shoulder_pan.pos", "elbow_flex.pos", "gripper.pos"]
    rng = np.random.default_rng(7)
    tables, rows = [], []
    for episode, length in enumerate((80, 120)):
        state = np.round(rng.normal(size=(length, 3)), 1).astype(np.float32)
        action = rng.normal(size=(length, 3)).astype(np.float32)
        time = (np.arange(length) / 30).astype(np.float32)
        columns = {"observation.state": pa.array(list(state), pa.list_(pa.float32(), 3) if version == "v3.0"
                                                 else pa.list_(pa.float32())),
                   "action": pa.array(list(action), pa.list_(pa.float32())),
                   "timestamp": pa.array(time), "frame_index": pa.array(np.arange(length)),
                   "episode_index": pa.array(np.full(length, episode)),
                   "task": pa.array(["pick"] * length)}
        tables.append(pa.table(columns))
        for i in range(length):
            values = {f"position {n[:-4]}": float(x) for n, x in zip(names, state[i])}
            values.update({f"command {n[:-4]}": float(x) for n, x in zip(names, action[i])})
            rows.append([round(float(time[i]) * 1e9), values])
    data = os.path.join(path, "data", "chunk-000")
    os.makedirs(data)
    os.makedirs(os.path.join(path, "meta"))
    if version == "v3.0":
        with pq.ParquetWriter(os.path.join(data, "file-000.parquet"), tables[0].schema, **options) as writer:
            for table in tables:
                writer.write_table(table)
    else:
        for episode, table in enumerate(tables):
            pq.write_table(table, os.path.join(data, f"episode_{episode:06d}.parquet"), **options)
    vector = {"dtype": "float32", "shape": [3], "names": names if version == "v3.0" else {"motors": names}}
    with open(os.path.join(path, "meta", "info.json"), "w", encoding="utf-8") as file:
        json.dump({"codebase_version": version, "fps": 30, "robot_type": "so101_follower",
                   "features": {"observation.state": vector, "action": vector}}, file)
    return rows


def write_aloha(path):
    rows = []
    rng = np.random.default_rng(3)
    qpos, qvel, action = rng.normal(size=(60, 14)), rng.normal(size=(60, 14)), rng.normal(size=(60, 14))
    with h5py.File(path, "w") as file:
        file.attrs["sim"] = False
        group = file.create_group("observations")
        group.create_dataset("qpos", data=qpos)
        group.create_dataset("qvel", data=qvel, compression="gzip")
        file.create_dataset("action", data=action.astype(np.float32))
    arm = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper"]
    names = [f"{side}_{joint}" for side in ("left", "right") for joint in arm]
    for i in range(60):
        values = {}
        for what, numbers in (("position", qpos), ("velocity", qvel), ("command", action.astype(np.float32))):
            values.update({f"{what} {n}": float(x) for n, x in zip(names, numbers[i])})
        rows.append([i * 20_000_000, values])
    return rows


def write_robomimic(path):
    rows = []
    rng = np.random.default_rng(4)
    with h5py.File(path, "w") as file:
        data = file.create_group("data")
        data.attrs["env_args"] = json.dumps({"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 25}})
        for demo in (0, 2, 10):
            q = rng.normal(size=(20, 7))
            group = data.create_group(f"demo_{demo}")
            group.create_dataset("obs/robot0_joint_pos", data=q)
            group.create_dataset("actions", data=np.zeros((20, 7)))
            rows += [[i * 40_000_000, {f"position joint_{k}": float(q[i, k]) for k in range(7)}] for i in range(20)]
    return rows


def main(folder):
    expected = {}

    def add(name, write, *arguments, **options):
        expected[name] = write(os.path.join(folder, name), *arguments, **options)

    for compression in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD):
        add(f"{compression.name}.mcap", write_mcap, compression)
    add("bag_mcap", write_rosbag, StoragePlugin.MCAP, 9, None)
    add("bag_mcap_file_zstd", write_rosbag, StoragePlugin.MCAP, 9, CompressionMode.FILE)
    add("bag_mcap_message_zstd", write_rosbag, StoragePlugin.MCAP, 9, CompressionMode.MESSAGE)
    add("bag_mcap_storage", write_rosbag, StoragePlugin.MCAP, 9, CompressionMode.STORAGE)
    add("bag_sqlite", write_rosbag, StoragePlugin.SQLITE3, 9, None)
    add("bag_sqlite_8", write_rosbag, StoragePlugin.SQLITE3, 8, None)
    add("bag_sqlite_file_zstd", write_rosbag, StoragePlugin.SQLITE3, 9, CompressionMode.FILE)
    add("bag_sqlite_message_zstd", write_rosbag, StoragePlugin.SQLITE3, 9, CompressionMode.MESSAGE)
    for layout in LAYOUTS:
        add(f"state_{layout}", write_controller_state, layout, StoragePlugin.MCAP)
        add(f"state_{layout}_sqlite", write_controller_state, layout, StoragePlugin.SQLITE3)
    add("lerobot_3", write_lerobot, "v3.0")
    add("lerobot_3_zstd", write_lerobot, "v3.0", compression="zstd", data_page_version="2.0")
    add("lerobot_2", write_lerobot, "v2.1", compression="none", use_dictionary=False)
    add("lerobot_2_pages", write_lerobot, "v2.1", data_page_size=300, data_page_version="2.0")
    add("aloha.hdf5", write_aloha)
    add("robomimic.hdf5", write_robomimic)
    with open(os.path.join(folder, "expected.json"), "w", encoding="utf-8") as file:
        json.dump(expected, file)


if __name__ == "__main__":
    main(sys.argv[1])
