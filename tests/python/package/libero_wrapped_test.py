#!/usr/bin/env python3
"""LIBERO's OffScreenRenderEnv with our wrapper beside PandaSim in parity mode, as wrapped_test.py does for robosuite's Lift.
Arms agree until a contact bifurcates, shown by PandaSim alone.

    libero_wrapped_test.py [TASK ...] [--scenarios NAME,...]      tasks such as libero_goal_03; prints the differences
"""
import argparse
import os
import sys

import numpy as np
import robostress as rs

import libero_parts
import panda_sim

BOUND = 1e-9  # [rad]


def first_above(difference):
    """The first step at which arms differ; len(difference) where they never do."""
    return int(np.append(np.flatnonzero(difference > BOUND), len(difference))[0])


def play(env, state, rows):
    """Joints where the arm was reset, qpos at the start, joints after each step, the last info."""
    env.seed(7)
    env.reset()
    home = np.array(env.sim.data.qpos[:7])
    env.set_init_state(state)
    qpos, played, info = np.array(env.sim.data.qpos), [], {}
    for row in rows:
        info = env.step(row)[-1]
        played.append(np.array(env.sim.data.qpos[:7]))
    return home, qpos, np.array(played), info


def bifurcation(reference, rows, trials=8):
    """The first step at which PandaSim leaves itself when the last digits of commands differ: a contact takes another side."""
    plain = reference(rows)
    draws = np.random.RandomState(0)
    return min(first_above(np.abs(reference(rows * (1 + 1e-14 * draws.uniform(-1, 1, rows.shape))) - plain).max(axis=1))
               for _ in range(trials))


def compare(task, names):
    env, state, rows = libero_parts.environment(task)
    for name in names:
        wrapped = rs.wrap(env, name, horizon=100)
        home, qpos, played, info = play(wrapped, state, rows)
        assert info["robostress"]["applied"].shape == (25, 7)
        wrapped.unwrap()

        def reference(commands):
            return panda_sim.played(env, qpos, home, commands, name)

        difference = np.abs(played - reference(rows)).max(axis=1)
        apart = first_above(difference)
        alone = bifurcation(reference, rows) if apart < len(rows) else len(rows)
        yield name, difference[:apart].max() if apart else np.inf, apart, alone
    env.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tasks", nargs="*", default=["libero_object_00"])
    parser.add_argument("--scenarios", default="aged_transmission,heavy_payload,isolated_backlash",
                        help="or `all`; three of them take minutes")
    options = parser.parse_args()
    if not libero_parts.TREE.is_dir():
        print(f"SKIPPED: no {libero_parts.TREE}")
        return 77
    os.environ.setdefault("MUJOCO_GL", "egl")
    folder, wrong = libero_parts.prepare(), False
    print("| task | scenario | largest difference [rad] | until step | PandaSim leaves itself at |\n|---|---|---:|---:|---:|")
    names = [s.name for s in rs.scenarios()] if options.scenarios == "all" else options.scenarios.split(",")
    for task in options.tasks:
        for name, difference, apart, alone in compare(task, names):
            wrong |= apart < alone
            print(f"| {task} | {name} | {difference:.1e} | {apart} | {alone if alone < 90 else '-'} |", flush=True)
    folder.cleanup()
    return int(wrong)


sys.exit(main())
