"""A model server of vla-eval at toy size. As a program: its rows, asked for by vla-eval's own client.

Prints four lines of seven numbers: what vla-eval's own server hands out, one row an observation, for
the views and the state that serve_lerobot_test.cc sends.
"""

import logging

import anyio
import numpy as np
from vla_eval.connection import Connection
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async

SIDE = 64


class Toy(PredictModelServer):
    """actions[i, j] = state[j] + i for 6 rows, of which 4 count. Column 3: the wrist's first red; 5: the step."""

    def __init__(self, noise="none"):
        super().__init__(chunk_size=4)
        self.noise, self.own, self.tasks = noise, np.random.default_rng(), {}

    def get_observation_params(self):
        return {"send_state": True, "send_wrist_image": True, "quat_no_antipodal": True}

    async def on_episode_start(self, config, ctx):
        assert ctx.session_id not in self.tasks, "the episode before has not ended"
        self.tasks[ctx.session_id] = config["task"]["name"]
        await super().on_episode_start(config, ctx)

    async def on_episode_end(self, result, ctx):
        del self.tasks[ctx.session_id]
        await super().on_episode_end(result, ctx)

    def predict(self, obs, ctx):
        assert obs["task_description"] == self.tasks[ctx.session_id], (obs["task_description"], self.tasks)
        assert obs["images"]["agentview"].dtype == np.uint8 and obs["images"]["agentview"].ndim == 3
        actions = obs["states"][None, :7] + np.arange(6)[:, None]
        actions[:, 3] = obs["images"]["wrist"][0, 0, 0]
        actions[:, 5] = ctx.step
        normal = {"none": lambda size: 0, "numpy": lambda size: np.random.normal(size=size),
                  "own": lambda size: self.own.normal(size=size)}[self.noise]
        actions[:, :3] += normal((6, 3))
        return {"actions": actions}


def view(k):
    return (200 + k + np.arange(3 * SIDE * SIDE) % 50).astype(np.uint8).reshape(SIDE, SIDE, 3)


async def main():
    logging.disable()
    observation = {"images": {"agentview": view(0), "wrist": view(1)}, "task_description": "do something",
                   "states": np.linspace(0.5, 8.5, 8, dtype=np.float32)}
    async with anyio.create_task_group() as group:
        port = await group.start(serve_async, Toy(), "127.0.0.1", 0)
        client = Connection(f"ws://127.0.0.1:{port}")
        await client.connect()
        await client.start_episode({"task": {"name": "do something"}})
        for _ in range(4):
            print(" ".join(f"{number:.9g}" for number in (await client.act(observation))["actions"]), flush=True)
        await client.close()
        group.cancel_scope.cancel()


if __name__ == "__main__":
    anyio.run(main)
