#!/usr/bin/env python3
"""What a sub-step costs beyond the C++ call: run by run_installed.py, with KERNEL_REFERENCE. Fastest of 60 rounds each."""
import os
import subprocess
import time

import numpy as np

import robostress as rs


def fastest(call, rounds=60, calls=2000):
    best = float("inf")
    for _ in range(rounds):
        begin = time.perf_counter_ns()
        for _ in range(calls):
            call()
        best = min(best, (time.perf_counter_ns() - begin) / calls)
    return best


print("| scenario | C++ [us] | bound arrays [us] | arrays by name [us] | beyond C++ [us] |\n|---|---|---|---|---|")
for scenario in ("clean", "aged_transmission", "heavy_payload"):
    kernel = float(subprocess.run([os.environ["KERNEL_REFERENCE"], scenario], stdout=subprocess.PIPE, check=True).stdout)
    given, bound = rs.JointErrors(scenario), rs.JointErrors(scenario)
    arm = {name: np.full(7, 0.1) for name in given.reads}
    asked = np.full(7, 10.0)
    bound.bind(**{name: values.copy() for name, values in arm.items()})
    for errors in (given, bound):
        errors.reset(**{name: values for name, values in arm.items() if name != "dq"})
        errors.begin_control_step(0)
    bound.dq[:] = 0.1
    costs = fastest(lambda: bound.sub_step(asked)), fastest(lambda: given.sub_step(asked, **arm))
    print(f"| {scenario} | {kernel / 1e3:.2f} | {costs[0] / 1e3:.2f} | {costs[1] / 1e3:.2f} | "
          f"{(costs[0] - kernel) / 1e3:.2f}, {(costs[1] - kernel) / 1e3:.2f} |")
