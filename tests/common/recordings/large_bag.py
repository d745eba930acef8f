"""A recording of seven joints at 500 Hz, as long as it takes: large_bag.py FILE.mcap MEGABYTES

For the memory that a reader takes; needs peers_requirements.txt.
"""

import struct
import sys

import numpy as np
from mcap.writer import CompressionType, Writer

sys.dont_write_bytecode = True
from write_recordings import JOINT_STATE  # noqa: E402, beside this file

NAMES = [f"joint_{k}" for k in range(7)]


def padded(body, alignment):
    return body + b"\0" * (-len(body) % alignment)


def joint_state(stamp, arrays):
    """The message in CDR."""
    body = padded(struct.pack("<iII", stamp // 10**9, stamp % 10**9, 1) + b"\0", 4) + struct.pack("<I", 7)
    for name in NAMES:
        text = name.encode() + b"\0"
        body = padded(body, 4) + struct.pack("<I", len(text)) + text
    for array in arrays:
        body = padded(padded(body, 4) + struct.pack("<I", 7), 8) + array.tobytes()
    return b"\0\1\0\0" + body


def main(path, megabytes):
    noise, phase, i = np.random.default_rng(0), np.arange(7.0), 0
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.LZ4)
        writer.start("ros2", "large_bag")
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", JOINT_STATE.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        while file.tell() < megabytes * 1e6:
            t, stamp = i * 0.002, 1_700_000_000_000_000_000 + i * 2_000_000
            arrays = [wave(t + phase) * size + error * noise.standard_normal(7)
                      for wave, size, error in ((np.sin, 1, 1e-5), (np.cos, 1, 1e-4), (np.sin, -3, 1e-3))]
            writer.add_message(channel, stamp, joint_state(stamp, arrays), stamp)
            i += 1
        writer.finish()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
