#!/usr/bin/env python3
"""Whether tasks of folders load and reset as LIBERO's own environments do.

    resets.py --robostress PROGRAM [--out FOLDER] BDDL_FOLDER...

Runs the original (the packages of requirements.txt beside this file; for LIBERO-PRO with its package first on
PYTHONPATH) and `robostress replay` on the first initial state of each task: the compiled models, the state that was set,
ten settle steps. One line a task:

    model    largest difference of an array of the compiled model that decides dynamics
    set      largest difference of a position after set_init_state
    settled  largest difference of a position [m, rad] after the settle steps, on the versions' own MuJoCos

Exit code 1 if a task does not load here, or its model or state differs by more than 1e-6.
"""

import argparse
import os
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE))
import look  # noqa: E402  (sets LIBERO_CONFIG_PATH)
import numpy as np  # noqa: E402

# Of the model: what MuJoCo 2 and 3 both have and mean the same by.
ARRAYS = (
    "qpos0 body_mass body_inertia body_ipos body_iquat body_pos body_quat body_parentid jnt_type jnt_qposadr jnt_bodyid "
    "jnt_pos jnt_axis jnt_range dof_damping dof_armature dof_frictionloss geom_type geom_bodyid geom_pos geom_quat geom_size "
    "geom_contype geom_conaffinity geom_friction geom_solref geom_solimp geom_margin site_bodyid site_pos site_quat site_size"
).split()


def read_safetensors(path):
    import json
    import struct

    raw = path.read_bytes()
    (length,) = struct.unpack("<Q", raw[:8])
    types = {"F64": np.float64, "F32": np.float32, "I32": np.int32, "U8": np.uint8}
    arrays = {}
    for name, entry in json.loads(raw[8 : 8 + length]).items():
        if name != "__metadata__":
            begin, end = entry["data_offsets"]
            data = raw[8 + length + begin : 8 + length + end]
            arrays[name] = np.frombuffer(data, types[entry["dtype"]]).reshape(entry["shape"])
    return arrays


def initial_states(folder, task):
    states = folder.parent.parent / "init_files" / folder.name
    npz = states / f"{task}.pruned_init.npz"
    return np.load(npz)["states"] if npz.exists() else look.read_init_states(states / f"{task}.pruned_init")


def original(bddl, row):
    """What `robostress replay --in` reads, with what the original had."""
    from libero.libero.envs.env_wrapper import ControlEnv

    env = ControlEnv(bddl_file_name=str(bddl), has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False)
    env.seed(look.SEED)
    env.reset()
    sim = env.env.sim
    model = sim.model._model
    record = {"reset_qpos": np.array(sim.data.qpos), "init_state": row}
    env.set_init_state(row)
    positions = [np.array(sim.data.qpos)]
    for _ in range(look.SETTLE):
        env.step(look.DUMMY)
        positions.append(np.array(sim.data.qpos))
    record["qpos"] = np.array(positions)
    record["actions"] = np.tile(np.array(look.DUMMY), (look.SETTLE, 1))
    record["success"] = np.array([float(env.check_success())])
    record["body_pos"], record["body_quat"] = np.array(model.body_pos), np.array(model.body_quat)
    for name in ARRAYS:
        record[f"model.{name}"] = np.array(getattr(model, name))
    env.close()
    return record


def largest(a, b):
    if a.shape != b.shape:
        return np.inf
    return float(np.max(np.abs(a.astype(float) - b.astype(float)), initial=0))


MESH = 7


def array_of(record, name):
    array = record[f"model.{name}"]
    # A mesh's own frame, along its principal axes, is another in MuJoCo 3.
    return array[record["model.geom_type"] != MESH] if name in ("geom_pos", "geom_quat", "geom_size") else array


def compare(theirs, ours):
    worst = max((largest(array_of(theirs, n), array_of(ours, n)), n) for n in ARRAYS)
    same = theirs["qpos"].shape == ours["qpos"].shape
    rows = [largest(theirs["qpos"][i], ours["qpos"][i]) if same else np.inf for i in (0, -1)]
    return worst, rows[0], rows[1], bool(theirs["success"][-1]) == bool(ours["success"][-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=pathlib.Path)
    parser.add_argument("--robostress", required=True)
    parser.add_argument("--out", type=pathlib.Path, help="keep the recordings here, and go on from them")
    options = parser.parse_args()
    look.link_assets()
    scratch = options.out or pathlib.Path(tempfile.mkdtemp())
    equal = total = 0
    for folder in options.folders:
        for index, bddl in enumerate(sorted(folder.glob("*.bddl"))):
            total += 1
            name = f"{folder.name} {index} {bddl.stem}"
            kept = scratch / folder.name / f"{index}.safetensors"
            kept.parent.mkdir(parents=True, exist_ok=True)
            if not kept.exists():
                try:
                    row = initial_states(folder, bddl.stem)[0]
                    look.write_safetensors(kept, original(bddl, row))
                except Exception as error:  # noqa: BLE001: whatever the original says
                    print(f"{name}: the original does not load: {type(error).__name__}: {error}", flush=True)
                    continue
            ours = kept.with_suffix(".ours")
            command = [options.robostress, "replay", "--libero-tasks", str(folder), "--task", str(index), "--in", str(kept),
                       "--out", str(ours), "--settle-steps", str(look.SETTLE)]
            run = subprocess.run(command, capture_output=True, text=True, env=os.environ, check=False)
            if run.returncode != 0:
                print(f"{name}: does not load here: {run.stderr.strip()}", flush=True)
                continue
            (model, array), at_set, settled, success = compare(read_safetensors(kept), read_safetensors(ours))
            good = model < 1e-6 and at_set < 1e-6 and success
            equal += good
            print(f"{name}: model {model:.1e} ({array}), set {at_set:.1e}, settled {settled:.1e}"
                  f"{'' if success else ', success differs'}{'' if good else '  DIFFERS'}", flush=True)
    print(f"{equal} of {total} tasks load and reset as the original")
    return 0 if equal == total else 1


if __name__ == "__main__":
    sys.exit(main())
