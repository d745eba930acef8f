"""Speaks the server's side of openpi's wire, with the packages that openpi's own server is made of.

    openpi_peer_server.py libero|aloha|droid [SCALE [ANSWERS]]

It prints its port. SCALE: of the actions (1); after ANSWERS of them it closes a connection. For each observation it checks keys, types and shapes as openpi's policies want
them, and answers actions that are a function of what it saw, so that the client can tell whether
its pictures and numbers arrived: actions[i, j] = state[j] + i, with the first pixel's red of the
first view in the last column. An observation without a prompt makes it fail as openpi's does.
"""

import asyncio
import sys
import traceback

import numpy as np
import websockets
from openpi_client import msgpack_numpy
from websockets.asyncio.server import serve

HORIZON = 10


def libero(observation):
    views = [observation["observation/image"], observation["observation/wrist_image"]]
    state = observation["observation/state"]
    return views, state, 7


def aloha(observation):
    images = observation["images"]
    views = [images[key] for key in ("cam_high", "cam_left_wrist", "cam_right_wrist")]
    for view in views:
        assert view.shape == (3, 224, 224), view.shape
    return [view.transpose(1, 2, 0) for view in views], observation["state"], 14


def droid(observation):
    views = [
        observation["observation/exterior_image_1_left"],
        observation["observation/wrist_image_left"],
    ]
    joints, gripper = observation["observation/joint_position"], observation["observation/gripper_position"]
    assert joints.shape == (7,) and gripper.shape == (1,), (joints.shape, gripper.shape)
    return views, np.concatenate([joints, gripper]), 8


def infer(read, observation):
    views, state, size = read(observation)
    for view in views:
        assert view.dtype == np.uint8 and view.shape == (224, 224, 3), (view.dtype, view.shape)
    assert state.dtype == np.float64, state.dtype
    assert isinstance(observation["prompt"], str)
    actions = np.resize(state, size)[None, :] + np.arange(HORIZON)[:, None]
    actions[:, -1] = views[0][0, 0, 0]
    return {"actions": actions, "policy_timing": {"infer_ms": 1.5}}


async def main():
    read = {"libero": libero, "aloha": aloha, "droid": droid}[sys.argv[1]]
    scale, most = float((sys.argv + ["1"])[2]), float((sys.argv + ["inf", "inf"])[3])
    packer = msgpack_numpy.Packer()

    async def handler(websocket):
        await websocket.send(packer.pack({"reset_pose": [0.0, 1.0]}))
        answers = 0
        while answers < most:
            try:
                observation = msgpack_numpy.unpackb(await websocket.recv())
                answer = infer(read, observation)
                answer["actions"] *= scale
                await websocket.send(packer.pack(answer))
                answers += 1
            except websockets.ConnectionClosed:
                break
            except Exception:
                await websocket.send(traceback.format_exc())
                await websocket.close(
                    code=websockets.frames.CloseCode.INTERNAL_ERROR,
                    reason="Internal server error. Traceback included in previous frame.",
                )
                raise

    # Pings after a fifth of a second of silence, and an end without a pong: openpi's own are the
    # same, after 20 seconds.
    async with serve(
        handler, "127.0.0.1", 0, compression=None, max_size=None, ping_interval=0.2, ping_timeout=0.2
    ) as server:
        print(server.sockets[0].getsockname()[1], flush=True)
        await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main())
