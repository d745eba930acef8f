"""Does what openpi's examples/simple_client does, with openpi's own client, and checks the replies.

    openpi_client_driver.py PORT libero|droid|aloha STEPS

Prints the server's metadata, and one line with the shape of the actions and the slowest answer.
"""

import sys
import time

import numpy as np
from openpi_client import websocket_client_policy

RANDOM = np.random.default_rng(0)


def image(height, width, planes_first=False):
    shape = (3, height, width) if planes_first else (height, width, 3)
    return RANDOM.integers(256, size=shape, dtype=np.uint8)


def libero():
    return {
        "observation/state": RANDOM.random(8),
        "observation/image": image(224, 224),
        "observation/wrist_image": image(224, 224),
        "prompt": "do something",
    }


def droid():
    return {
        "observation/exterior_image_1_left": image(224, 224),
        "observation/wrist_image_left": image(224, 224),
        "observation/joint_position": RANDOM.random(7),
        "observation/gripper_position": RANDOM.random(1),
        "prompt": "do something",
    }


def aloha():
    cameras = ("cam_high", "cam_low", "cam_left_wrist", "cam_right_wrist")
    return {
        "state": np.ones((14,)),
        "images": {camera: image(224, 224, planes_first=True) for camera in cameras},
        "prompt": "do something",
    }


def main():
    port, env, steps = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    observe = {"libero": libero, "droid": droid, "aloha": aloha}[env]
    policy = websocket_client_policy.WebsocketClientPolicy(host="127.0.0.1", port=port)
    metadata = policy.get_server_metadata()
    print("metadata", metadata)
    slowest_ms = 0
    for step in range(steps):
        begin = time.monotonic()
        reply = policy.infer(observe())
        slowest_ms = max(slowest_ms, 1e3 * (time.monotonic() - begin))
        actions = reply["actions"]
        assert actions.dtype == np.float32 and actions.ndim == 2, actions
        assert actions.shape[1] == metadata["policies"][0]["action_dim"], actions.shape
        assert np.isfinite(actions).all()
        for timing in ("server_timing", "policy_timing"):
            assert all(value >= 0 for value in reply[timing].values()), reply[timing]
        assert ("prev_total_ms" in reply["server_timing"]) == (step > 0)
    print("served", steps, "chunks of", actions.shape, "slowest", round(slowest_ms, 1), "ms")


if __name__ == "__main__":
    main()
