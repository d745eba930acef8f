#!/usr/bin/env python3
"""What the wrapper adds to a control step of robosuite: CPU time, every second step wrapped. Run by run_installed.py."""
import time

import numpy as np
import robosuite

import robostress as rs

print("| task | scenario | robosuite [ms] | wrapped [ms] | slower |\n|---|---|---|---|---|")
for task in ("Lift", "PickPlace", "NutAssembly"):
    env = robosuite.make(task, robots="Panda", has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False,
                         controller_configs=robosuite.load_controller_config(default_controller="OSC_POSE"),
                         control_freq=20, horizon=100000, hard_reset=False)
    for scenario in ("aged_transmission", "heavy_payload"):
        wrapped = rs.wrap(env, scenario)
        wrapped.reset()
        action, times = np.array([0.1, 0.05, -0.02, 0.1, 0, 0.1, -1]), ([], [])
        for k in range(200):
            action, on = -action, k % 2
            env._pre_action = wrapped._pre_action if on else wrapped._original
            begin = time.process_time()
            (wrapped if on else env).step(action)
            times[on].append(time.process_time() - begin)
        wrapped.unwrap()
        plain, bent = (1e3 * np.median(t[10:]) for t in times)
        print(f"| {task} | {scenario} | {plain:.2f} | {bent:.2f} | {100 * (bent / plain - 1):.1f} % |", flush=True)
