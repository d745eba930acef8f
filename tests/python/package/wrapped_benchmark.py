#!/usr/bin/env python3
"""What the wrapper adds to a control step: CPU time, one step of each pair wrapped, by lot. Run by run_installed.py.

    wrapped_benchmark.py [TASK ...] [--steps N] [--repeats N] [--views]      of robosuite, or LIBERO's such as libero_object_00
"""
import argparse
import os
import time

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")  # Mesa draws in the calling thread

import numpy as np
import robosuite

import robostress as rs

ACTION = np.array([0.1, 0.05, -0.02, 0.1, 0, 0.1, -1])


def slower(env, base, scenario, steps):
    """Median CPU times of a step [ms], unwrapped and wrapped."""
    wrapped, times = rs.wrap(env, scenario), ([], [])
    wrapped.reset()
    first = np.random.RandomState(0).randint(2, size=steps)
    for k in range(steps):
        on = (first[k // 2] + k) % 2
        step = wrapped.step if on else lambda action: type(base).step(base, action)
        action = ACTION * (1 if k % 4 < 2 else -1)
        begin = time.process_time()
        step(action)
        times[on].append(time.process_time() - begin)
    wrapped.unwrap()
    return [1e3 * np.median(t[5:]) for t in times]


def make(task, views):
    if task.startswith("libero"):
        import libero_parts
        folder = libero_parts.prepare()
        env = libero_parts.environment(task)[0]
        return env, env.env, folder
    configs = {"controller_configs": robosuite.load_controller_config(default_controller="OSC_POSE")} if hasattr(
        robosuite, "load_controller_config") else {}
    drawn = {"camera_names": ["agentview", "robot0_eye_in_hand"], "camera_heights": 256, "camera_widths": 256} if views else {}
    env = robosuite.make(task, robots="Panda", has_renderer=False, has_offscreen_renderer=views, use_camera_obs=views,
                         control_freq=20, horizon=100000, hard_reset=False, **drawn, **configs)
    return env, env, None


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=["Lift", "PickPlace", "NutAssembly"])
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--views", action="store_true", help="robosuite draws two views of 256 px after each step")
    line = parser.parse_args()
    print(f"robosuite {robosuite.__version__}; medians of {line.steps // 2} steps, {line.repeats} repeats")
    print("| task | scenario | robosuite [ms] | wrapped [ms] | slower | from | to |\n|---|---|---:|---:|---:|---:|---:|")
    for task in line.tasks:
        env, base, _kept = make(task, line.views)
        for scenario in ("clean", "aged_transmission", "heavy_payload"):
            rows = np.array([slower(env, base, scenario, line.steps) for _ in range(line.repeats)])
            percent = 100 * (rows[:, 1] / rows[:, 0] - 1)
            plain, bent = np.median(rows, axis=0)
            print(f"| {task} | {scenario} | {plain:.2f} | {bent:.2f} | {np.median(percent):.1f} % | {percent.min():.1f} % | "
                  f"{percent.max():.1f} % |", flush=True)


main()
