#!/usr/bin/env python3
"""How much of what the nominal arm is wrong by comes with turning: eval/docs/turning_tool.py RUN

RUN: of `robostress sweep --scenarios clean --methods base --record-episodes PX`. Translation and rotation commands go through
the nominal arm (adapter/nominal_arm.h); what it moves more than the arm did, x, y, z of a step, is fitted by what it turns:
e = C r, C [3, 3] of each episode. Prints, a line a task: |e| (root mean square, normalised commands), the share of its
variance that C r explains, and |C|. Needs NumPy.
"""

import json
import pathlib
import struct
import sys

import numpy as np

KP, SUB_STEPS, STEP_S, COMMAND_M = 150, 25, 0.002, 0.05


def tensors(path):
    data = path.read_bytes()
    end = 8 + struct.unpack("<Q", data[:8])[0]
    header = json.loads(data[8:end])
    about = header.pop("__metadata__")
    kinds = {"F32": np.float32, "F64": np.float64}
    return about, {k: np.frombuffer(data[end:][slice(*v["data_offsets"])], kinds[v["dtype"]]).reshape(v["shape"])
                   for k, v in header.items() if v["dtype"] in kinds}


def nominal(commands):
    """Displacements [n, 6] of the nominal arm, goal achieved."""
    velocity, moved = np.zeros(6), []
    for command in np.clip(commands[:, :6], -1, 1):
        x = np.zeros(6)
        for _ in range(SUB_STEPS):
            velocity = velocity + STEP_S * (KP * (command - x) - 2 * KP ** 0.5 * velocity)
            x = x + STEP_S * velocity
        moved.append(x)
    return np.array(moved)


def main():
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    files = sorted(pathlib.Path(sys.argv[1]).glob("units/*/episodes/*.safetensors"))
    if not files:
        raise SystemExit(f"{sys.argv[1]}/units/*/episodes has no recorded episode: sweep it with --record-episodes")
    rows = []
    for path in files:
        about, tensor = tensors(path)
        asked = nominal(tensor["sent"])[:-1]
        error = asked[:, :3] - np.diff(tensor["tool"][:, :3], axis=0) / COMMAND_M
        coupling, *_ = np.linalg.lstsq(asked[:, 3:], error, rcond=None)
        share = 1 - np.sum((error - asked[:, 3:] @ coupling) ** 2) / np.sum(error ** 2)
        rows.append((about["suite"], int(about["task"]), np.sqrt(np.mean(np.sum(error ** 2, axis=1))), share,
                     np.linalg.norm(coupling), len(error)))
    print("suite, task | |e| | explained | |C| | steps")
    for suite, task, size, share, norm, steps in sorted(rows):
        print(f"{suite} {task} | {size:.3f} | {share:.2f} | {norm:.2f} | {steps}")
    shares = sorted(r[3] for r in rows)
    print(f"{len(rows)} episodes, median explained {shares[len(shares) // 2]:.2f}")


if __name__ == "__main__":
    main()
