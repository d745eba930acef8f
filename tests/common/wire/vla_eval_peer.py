"""vla-eval's own server with a tiny model, and vla-eval's own client, from its package.

    vla_eval_peer.py serve LOG [CUT]   prints its port; LOG gets a line for each episode's start and end;
                                       every CUT-th observation ends the connection instead of being answered
    vla_eval_peer.py ask PORT          prints the rows that vla-eval's client gets for four observations

The model wants what vla-eval's LIBERO benchmark shows: two views of 256 px, a state of 8 numbers. It
refuses anything else. Its actions are small and a function of every byte that it saw, so that the
client can tell whether its pictures and numbers arrived, and the simulator's arm moves gently.
"""

import logging
import sys

import anyio
import numpy as np
import websockets
from vla_eval.connection import Connection
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async

SIDE = 256


class Tiny(PredictModelServer):
    def __init__(self, log, cut):
        super().__init__(chunk_size=2)
        self.log, self.cut, self.seen, self.tasks = log, cut, 0, {}

    def get_observation_params(self):
        return {"send_state": True, "send_wrist_image": True, "quat_no_antipodal": True}

    def _say(self, words):
        with open(self.log, "a") as file:
            print(words, file=file)

    async def on_episode_start(self, config, ctx):
        assert ctx.session_id not in self.tasks, "the episode before has not ended"
        self.tasks[ctx.session_id] = config["task"]["name"]
        self._say(f"start {config['task']['name']}")
        await super().on_episode_start(config, ctx)

    async def on_episode_end(self, result, ctx):
        self._say(f"end {self.tasks.pop(ctx.session_id)}")
        await super().on_episode_end(result, ctx)

    async def on_observation(self, obs, ctx):
        self.seen += 1
        if self.cut and self.seen % self.cut == 0:
            raise websockets.exceptions.ConnectionClosedError(None, None)  # the server hangs up
        await super().on_observation(obs, ctx)

    def predict(self, obs, ctx):
        assert obs["task_description"] == self.tasks[ctx.session_id], (obs["task_description"], self.tasks)
        assert list(obs["images"]) == ["agentview", "wrist"], list(obs["images"])
        for view in obs["images"].values():
            assert view.dtype == np.uint8 and view.shape == (SIDE, SIDE, 3), (view.dtype, view.shape)
        assert obs["states"].dtype == np.float64 and obs["states"].shape == (8,), obs["states"]
        weights = np.arange(1, 3 * SIDE * SIDE + 1)
        sums = [int(view.reshape(-1) @ weights) % 1009 for view in obs["images"].values()]
        action = [sums[0] / 5045, sums[1] / 5045, obs["states"][0] / 10, ctx.step / 10000, 0, 0, -1]
        return {"actions": np.array([action, np.array(action) / 2], dtype=np.float32)}


def view(k):
    return (k + np.arange(3 * SIDE * SIDE) % 251).astype(np.uint8).reshape(SIDE, SIDE, 3)


async def serve(log, cut):
    logging.disable()
    async with anyio.create_task_group() as group:
        print(await group.start(serve_async, Tiny(log, cut), "127.0.0.1", 0), flush=True)


async def ask(port):
    observation = {"images": {"agentview": view(0), "wrist": view(1)}, "task_description": "do something",
                   "states": np.linspace(0.5, 2.25, 8)}
    client = Connection(f"ws://127.0.0.1:{port}")
    await client.connect()
    await client.start_episode({"task": {"name": "do something"}})
    for _ in range(4):
        print(" ".join(f"{number:.9g}" for number in (await client.act(observation))["actions"]), flush=True)
    await client.end_episode({})
    await client.close()


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        anyio.run(serve, sys.argv[2], int(sys.argv[3]) if len(sys.argv) > 3 else 0)
    else:
        anyio.run(ask, int(sys.argv[2]))
