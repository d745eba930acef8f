#!/usr/bin/env python3
"""What an episode costs in LIBERO's own environment: physics and controller, and drawing.

    speed.py --demonstrations FILE.hdf5 --suite libero_goal --task 8 [--episodes 3] [--initial-state 0]

Plays the commands of the first demonstrations of a file in LIBERO's form (`robostress record --suite SUITE
--tasks TASK --format hdf5`), with openpi's protocol: two views of 256 px, ten settle steps. CPU seconds of this
process, one thread. LIBERO draws both views after every control step;
`without views` draws none, so that the difference is drawing.

Prints one JSON line: steps, seconds an episode with and without views, seconds of a reset.
"""

import argparse
import json
import os
import pathlib
import sys
import time
from runpy import run_path

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa draws in the calling thread, as ours does
look = run_path(str(pathlib.Path(__file__).with_name("look.py")), run_name="look")

import h5py  # noqa: E402
import numpy as np  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--demonstrations", required=True, type=pathlib.Path)
    parser.add_argument("--suite", required=True)
    parser.add_argument("--task", required=True, type=int)
    parser.add_argument("--episodes", default=3, type=int)
    parser.add_argument("--initial-state", default=0, type=int)
    options = parser.parse_args()
    look["link_assets"]()
    from libero.libero import envs
    from libero.libero.envs.env_wrapper import ControlEnv

    root = pathlib.Path(envs.__file__).parent.parent
    task_map = run_path(str(root / "benchmark" / "libero_suite_task_map.py"))["libero_task_map"]
    name = task_map[options.suite][options.task]
    rows = look["read_init_states"](root / "init_files" / options.suite / f"{name}.pruned_init")
    with h5py.File(options.demonstrations) as file:
        commands = [np.array(file[f"data/demo_{k}/actions"]) for k in range(options.episodes)]

    def play(views):
        make = envs.OffScreenRenderEnv if views else ControlEnv
        keywords = {} if views else {"has_offscreen_renderer": False, "use_camera_obs": False}
        env = make(
            bddl_file_name=str(root / "bddl_files" / options.suite / f"{name}.bddl"),
            camera_heights=256,
            camera_widths=256,
            **keywords,
        )
        env.seed(look["SEED"])
        resets, episodes = [], []
        for actions in commands:
            start = time.process_time()
            env.reset()
            env.set_init_state(rows[options.initial_state])
            resets.append(time.process_time() - start)
            for _ in range(look["SETTLE"]):
                env.step(look["DUMMY"])
            start = time.process_time()
            for action in actions:
                env.step(list(action))
            episodes.append(time.process_time() - start)
        env.close()
        return float(np.median(episodes)), float(np.median(resets))

    episode, reset = play(views=True)
    bare, _ = play(views=False)
    steps = float(np.median([len(actions) for actions in commands]))
    print(json.dumps({"task": name, "steps": steps, "episode_s": episode, "without_views_s": bare, "reset_s": reset}))


if __name__ == "__main__":
    sys.exit(main())
