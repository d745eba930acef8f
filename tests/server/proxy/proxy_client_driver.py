"""An arm with friction, led by openpi's own, unmodified client.

    proxy_client_driver.py PORT CHUNKS [PIXELS]

The arm is numbers: a mass of 1 on each axis under kp (goal - x) - kd v, goal = x + command, with
Coulomb friction. Its state is LIBERO's, its two views are PIXELS x PIXELS. Prints
"error E p50 MS p99 MS": how far from the goal (3, -2, 0) it ends, in command units, and how long
infer() took.
"""

import sys
import time

import numpy as np
from openpi_client import websocket_client_policy

FRICTION, KP, SUB_STEPS = 60.0, 150.0, 100
KD = 2 * KP**0.5


def step(x, v, command):
    goal, h = x + np.clip(command, -1, 1), 0.05 / SUB_STEPS
    for _ in range(SUB_STEPS):
        push = KP * (goal - x) - KD * v
        against = FRICTION * np.sign(np.where(v != 0, v, push))
        following = v + h * (push - against)
        held = ((v == 0) & (np.abs(push) <= FRICTION)) | (following * v < 0)
        v = np.where(held, 0.0, following)
        x = x + h * v
    return x, v


def main():
    port, chunks = int(sys.argv[1]), int(sys.argv[2])
    pixels = int(sys.argv[3]) if len(sys.argv) > 3 else 8
    view = np.random.default_rng(0).integers(256, size=(pixels, pixels, 3), dtype=np.uint8)
    policy = websocket_client_policy.WebsocketClientPolicy(host="127.0.0.1", port=port)
    x, v, took = np.zeros(3), np.zeros(3), []
    for _ in range(chunks):
        state = np.concatenate([0.05 * x, [0.0, 0.0, 0.0, 0.02, -0.02]])
        observation = {
            "observation/state": state,
            "observation/image": view,
            "observation/wrist_image": view,
            "prompt": "go there",
        }
        begin = time.perf_counter()
        actions = policy.infer(observation)["actions"]
        took.append(1e3 * (time.perf_counter() - begin))
        assert actions.shape == (10, 7), actions.shape
        assert (actions[:, 6] == -1).all(), actions[:, 6]
        for action in actions[:5]:
            x, v = step(x, v, action[:3])
    error = np.linalg.norm(np.array([3.0, -2.0, 0.0]) - x)
    print(f"error {error:.4f} p50 {np.percentile(took, 50):.3f} p99 {np.percentile(took, 99):.3f}")


if __name__ == "__main__":
    main()
