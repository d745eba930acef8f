#!/usr/bin/env python3
"""Draws arms whose joints are worn at random, each on its own, and writes them as scenario files.

Every joint gets the paper's nominal errors (tab:base_params), each times a factor of its own: friction U(1, 2.5), backlash
log-uniform in (1, 15), stiffness over log-uniform in (1, 5), the gravity residual times U(-4, 4). An error is there with
probability 3/4. Compliance keeps the paper's inertia, so that its frequency falls with the root of the stiffness.

    random_wear.py --seed 2901 --count 4 --out eval/conditions/unseen
"""

import argparse
import math
import os
import random

# Fc, Fs, vs, sigma_v, B, M_eff, K; the first four joints, the last three.
NOMINAL = [(2.175, 3.480, 0.15, 0.348, 0.00087, 0.70, 6000.0)] * 4 + [(0.480, 0.720, 0.10, 0.048, 0.00130, 0.20, 4000.0)] * 3
BETA = [0.05, 0.10, 0.06, 0.10, 0.08, 0.08, 0.05]
PRESENT = 0.75


def log_uniform(draw, low, high):
    return math.exp(draw.uniform(math.log(low), math.log(high)))


def joint_effects(draw, joint):
    Fc, Fs, vs, sigma_v, B, M_eff, K = NOMINAL[joint]
    friction, backlash, compliance, gravity = (draw.uniform(1, 2.5), log_uniform(draw, 1, 15), log_uniform(draw, 1, 5),
                                               draw.uniform(-4, 4))
    K /= compliance
    effects = [f"{{type: stribeck_friction, Fc: {friction * Fc:.4g}, Fs: {friction * Fs:.4g}, vs: {vs}, "
               f"sigma_v: {friction * sigma_v:.4g}}}",
               f"{{type: backlash, B: {backlash * B:.4g}}}",
               f"{{type: compliance, K: {K:.5g}, frequency: {math.sqrt(K / M_eff) / (2 * math.pi):.4g}}}",
               f"{{type: gravity_error, beta: {gravity * BETA[joint]:.3g}}}"]
    return [effect for effect in effects if draw.random() < PRESENT]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=4)
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    draw = random.Random(args.seed)
    for index in range(args.count):
        with open(os.path.join(args.out, f"random_wear_{index}.yaml"), "w") as file:
            file.write(f"title: Random wear {index}\njoints:\n")
            for joint in range(7):
                effects = joint_effects(draw, joint)
                if effects:
                    file.write(f"  - name: J{joint + 1}\n    effects:\n" + "".join(f"      - {e}\n" for e in effects))


if __name__ == "__main__":
    main()
