"""Reads an exported episode with the peers' readers: read_mcap.py FILE.mcap RECORDING.safetensors

Fails unless every message is what the recording holds, to the bit, and the file's indexes and CRCs hold.
"""

import io
import json
import struct
import sys
import zlib

import numpy as np
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Footer
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

SECOND = 1_000_000_000
ACTION = ["x", "y", "z", "rx", "ry", "rz", "gripper"]
STATE = ["x", "y", "z", "rx", "ry", "rz", "finger1", "finger2"]
JOINTS = [f"j{i}" for i in range(1, 8)]


def read_recording(path):
    with open(path, "rb") as file:
        data = file.read()
    size = struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:8 + size])
    metadata = header.pop("__metadata__")
    types = {"F32": np.float32, "F64": np.float64, "I64": np.int64, "U8": np.uint8}
    tensors = {}
    for name, entry in header.items():
        begin, end = entry["data_offsets"]
        tensors[name] = np.frombuffer(data[8 + size + begin:8 + size + end], types[entry["dtype"]]).reshape(entry["shape"])
    return tensors, metadata


def pictures(tensors, camera):
    ends = [0] + list(tensors[f"picture.{camera}.ends"])
    return [tensors[f"picture.{camera}"][a:b].tobytes() for a, b in zip(ends, ends[1:])]


def expected_of(tensors):
    """What every topic's messages hold: functions of the decoded message, and rows to equal."""
    def fields(names):
        return lambda m: [getattr(m, name) for name in names]

    def pose(m):
        p, q = m.pose.position, m.pose.orientation
        return [p.x, p.y, p.z, q.w, q.x, q.y, q.z]

    names = [f"J{i}" for i in range(1, 8)]
    joint_states = [(names, list(q), list(dq), []) for q, dq in zip(tensors["q"], tensors["dq"])]
    expected = {
        "/joint_states": (lambda m: (m.name, list(m.position), list(m.velocity), list(m.effort)), joint_states),
        "/joints/position": (fields(JOINTS), tensors["q"].tolist()),
        "/joints/velocity": (fields(JOINTS), tensors["dq"].tolist()),
        "/tool_pose": (pose, tensors["tool"].tolist()),
        "/gripper": (fields(["opening"]), tensors["gripper"].tolist()),
        "/observation/state": (fields(STATE), tensors["proprioception"].tolist()),
    }
    for name in ("commanded", "sent", "measured"):
        expected[f"/action/{name}"] = (fields(ACTION), tensors[name].tolist())
    for key in tensors:
        if key.startswith("picture.") and not key.endswith(".ends"):
            camera = key[len("picture."):]
            expected[f"/camera/{camera}"] = (lambda m: (m.format, bytes(m.data)),
                                             [("png", picture) for picture in pictures(tensors, camera)])
    return expected


def stamp_of(t, rate_hz):
    return SECOND + round(t * SECOND / rate_hz)


def check_messages(reader, expected, steps, rate_hz, **between):
    """Of all topics the messages of these steps, in order; how many."""
    at = {topic: 0 for topic in expected}
    for _, channel, message, decoded in reader.iter_decoded_messages(**between):
        (read, rows), t = expected[channel.topic], steps[at[channel.topic]]
        stamp = decoded.header.stamp.sec * SECOND + decoded.header.stamp.nanosec
        assert (stamp, message.log_time, message.publish_time) == (stamp_of(t, rate_hz),) * 3, (channel.topic, t, stamp)
        assert message.sequence == t, (channel.topic, t, message.sequence)
        assert read(decoded) == rows[t], f"{channel.topic}, step {t}: {read(decoded)} is not {rows[t]}"
        at[channel.topic] += 1
    assert set(at.values()) == {len(steps)}, at
    return sum(at.values())


def check_summary(data):
    """The CRC and the offsets of the summary section, which the library does not check."""
    footer_at = len(data) - 8 - 29  # before the magic, a record of 20 bytes
    opcode, length, summary_at, offsets_at, crc = struct.unpack("<BQQQI", data[footer_at:-8])
    assert (opcode, length) == (2, 20)
    assert crc == zlib.crc32(data[summary_at:footer_at + 25]) != 0, crc
    at, groups = summary_at, []
    for offset in StreamReader(io.BytesIO(data[offsets_at:footer_at] + data[footer_at:]), skip_magic=True).records:
        if isinstance(offset, Footer):
            break
        assert offset.group_start == at, offset
        while at < offset.group_start + offset.group_length:
            assert data[at] == offset.group_opcode, offset
            at += 9 + struct.unpack("<Q", data[at + 1:at + 9])[0]
        groups.append(Opcode(offset.group_opcode).name)
    assert at == offsets_at, "the groups do not fill the summary section"
    return groups


def main(path, recording):
    tensors, recorded = read_recording(recording)
    expected, rate_hz = expected_of(tensors), float(recorded["rate_hz"])
    steps = range(len(tensors["q"]))
    with open(path, "rb") as file:
        data = file.read()
    groups = check_summary(data)
    factory = [DecoderFactory()]
    seeking = SeekingReader(io.BytesIO(data), validate_crcs=True, decoder_factories=factory)
    summary = seeking.get_summary()
    messages = check_messages(seeking, expected, steps, rate_hz)
    statistics = summary.statistics
    assert statistics.message_count == messages and statistics.chunk_count == len(summary.chunk_indexes)
    assert statistics.schema_count == len(summary.schemas) and statistics.channel_count == len(summary.channels)
    assert statistics.channel_message_counts == {id: len(steps) for id in summary.channels}
    assert statistics.message_start_time == SECOND
    assert statistics.message_end_time == stamp_of(steps[-1], rate_hz)
    middle = steps[len(steps) // 3:2 * len(steps) // 3]
    check_messages(SeekingReader(io.BytesIO(data), validate_crcs=True, decoder_factories=factory), expected, middle, rate_hz,
                   starting_at=stamp_of(middle[0], rate_hz), ending_at=stamp_of(middle[-1], rate_hz))
    # From the front, which is how the CRC of the data section is validated.
    check_messages(NonSeekingReader(io.BytesIO(data), validate_crcs=True, decoder_factories=factory), expected, steps, rate_hz)
    (metadata,) = seeking.iter_metadata()
    for key in ("scenario", "method", "seed", "initial_state", "task", "episode", "instruction", "severity"):
        assert metadata.metadata[key] == recorded[key], key
    assert metadata.metadata["success"] == ("true" if recorded["success"] in ("1", "true") else "false")
    print(f"{messages} messages of {len(expected)} topics in {statistics.chunk_count} chunks; {' '.join(groups)}; "
          f"{metadata.metadata['scenario']} {metadata.metadata['method']}")


if __name__ == "__main__":
    main(*sys.argv[1:])
