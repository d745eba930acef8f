#!/usr/bin/env python3
"""Serves a model server of vla-eval on openpi's WebSocket wire, from the environment that it runs in.

    pip install websockets msgpack        # beside vla-eval 0.8; nothing of RoboStress but the file beside this one
    python robostress_serve_vla_eval.py --model-server vla_eval.model_servers.pi0:Pi0ModelServer --arg checkpoint=...

vla-eval's own wire is asked at every control step, with all views, and hands out a chunk row by row.
This one answers the whole chunk that `predict` returns, so a simulator renders once a chunk, and
takes `seed`, so that the sampling noise of two runs can be paired. The wire, and all options of the
server, are those of robostress_serve_lerobot.py.

The class is loaded in this process; its `predict` gets what vla-eval's LIBERO benchmark would send:
`images` {"agentview": uint8 [H, W, 3], "wrist": ...}, `task_description`, `states` [state_dim].
Which of them, `get_observation_params` of the class says. A message's views are openpi's: upright, as
vla-eval sends them. --camera gives other cameras.
"""

import asyncio
import hashlib
import importlib
import importlib.util
import json
import os
import sys

import numpy as np
from robostress_serve_lerobot import (
    TURNS,
    Camera,
    ObservationReader,
    Refused,
    add_server_options,
    argparse,
    drawn_from,
    file_digest,
    installed,
    obeys_seed,
    run,
    whole,
)

LIBERO = {"agentview": "observation/image", "wrist": "observation/wrist_image"}
# What this file does about a wish of a model server's get_observation_params.
KNOWN_WISHES = ("send_state", "send_wrist_image")


def load_class(name):
    """MODULE:CLASS, or FILE.py:CLASS."""
    where, separator, class_name = name.rpartition(":")
    if not separator:
        raise Refused(f"--model-server {name}: must be MODULE:CLASS or FILE.py:CLASS")
    try:
        if where.endswith(".py"):
            spec = importlib.util.spec_from_file_location(os.path.basename(where)[:-3], where)
            module = importlib.util.module_from_spec(spec)
            sys.modules[spec.name] = module
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(where)
        return getattr(module, class_name)
    except Exception as error:
        raise Refused(f"--model-server {name}: {type(error).__name__}: {error}")


def read_arguments(entries):
    """--arg NAME=VALUE entries; VALUE is JSON, else text."""
    arguments = {}
    for entry in entries:
        name, separator, text = entry.partition("=")
        if not separator or not name:
            raise Refused(f"--arg {entry}: must be NAME=VALUE")
        try:
            arguments[name] = json.loads(text)
        except ValueError:
            arguments[name] = text
    return arguments


def identity(model_class, arguments):
    """What is known of the model: class and arguments, and the bytes of files that an argument names."""
    files = {v: file_digest(v) for v in arguments.values() if isinstance(v, str) and os.path.isfile(v)}
    for folder in (v for v in arguments.values() if isinstance(v, str) and os.path.isdir(v)):
        for root, _, names in os.walk(folder):
            paths = [os.path.join(root, name) for name in names]
            files |= {p: file_digest(p) for p in paths if os.path.isfile(p)}
    name = f"{model_class.__module__}:{model_class.__qualname__}"
    text = json.dumps([name, arguments, sorted(files.values())], sort_keys=True)
    return {"type": name, "arguments": json.dumps(arguments), "files": dict(sorted(files.items())[:1000]),
            "sha256": hashlib.sha256(text.encode()).hexdigest(), "versions": {"vla_eval": installed("vla-eval")}}


class VlaEvalModel:
    """A model server of vla-eval, as robostress_serve_lerobot.Server wants a policy. Used by one thread."""

    exclusive = False

    def __init__(self, options):
        try:
            from vla_eval.model_servers.base import SessionContext
            from vla_eval.model_servers.predict import PredictModelServer
        except ImportError as error:
            raise Refused(f"needs vla-eval in this environment: {error}")
        self.make_context, self.contexts = SessionContext, {}
        model_class, arguments = load_class(options.model_server), read_arguments(options.arg)
        if not (isinstance(model_class, type) and issubclass(model_class, PredictModelServer)):
            raise Refused(f"--model-server {options.model_server}: is no PredictModelServer, so it has no predict")
        try:
            self.model = model_class(**arguments)
        except TypeError as error:
            raise Refused(f"--model-server {options.model_server}: its arguments (--arg) do not fit: {error}")
        if self.model.continuous_inference:
            raise Refused("--arg continuous_inference: answers come when they come there; a sweep asks and waits")
        self.binary_gripper = options.binary_gripper
        wishes = self.model.get_observation_params() or {}
        unknown = {key: value for key, value in wishes.items() if key not in KNOWN_WISHES}
        if unknown:
            print(f"warning: this model server asks its benchmark for {unknown}, which the client has to do",
                  file=sys.stderr)
        cameras = dict(entry.partition("=")[::2] for entry in options.camera)
        if not all(cameras.values()):
            raise Refused(f"--camera {' '.join(options.camera)}: each must be NAME=KEY, such as wrist=observation/wrist_image")
        if not cameras:
            cameras = {n: key for n, key in LIBERO.items() if n == "agentview" or wishes.get("send_wrist_image")}
        self.reader = ObservationReader(
            [Camera(name, options.view_side, options.view_side, key) for name, key in cameras.items()],
            options.state_dim if wishes.get("send_state") else 0,
            True,
            turn=options.turn,
            any_size=True,
            max_view_side=options.max_view_side,
        )
        actions, extensions = obeys_seed(self._warm_up)
        self.metadata = {
            "server": "robostress_serve_vla_eval",
            "extensions": extensions,
            "policies": [
                {
                    "name": options.name or model_class.__name__,
                    "cameras": list(cameras),
                    "camera_keys": list(cameras.values()),
                    "state_dim": self.reader.state_dim,
                    "action_dim": int(actions.shape[1]),
                    "action_horizon": len(actions),
                    "image_width": options.view_side,
                    "image_height": options.view_side,
                    "resizes_images": True,
                    "max_view_side": options.max_view_side,
                }
            ],
            "model": identity(model_class, arguments),
        }

    def _warm_up(self):
        views = {c.feature: np.zeros((c.height, c.width, 3), np.uint8) for c in self.reader.cameras}
        state = np.zeros(self.reader.state_dim, np.float32) if self.reader.state_dim else None
        actions = self._actions(views, state, "warm up", 0, client=0)
        self.forget(0)
        return actions

    def reset(self, client):
        """The client's next observation begins an episode."""
        self.forget(client)

    def forget(self, client):
        context = self.contexts.pop(client, None)
        if context is not None:
            asyncio.run(self.model.on_episode_end({}, context))

    def infer(self, message, seed, client):
        """float32 [rows, action_dim], what `predict` returns."""
        return self._actions(*self.reader.read(message), seed, client)

    def _actions(self, views, state, task, seed, client):
        observation = {"images": views, "task_description": task}
        if state is not None:
            observation["states"] = state
        with drawn_from(seed):
            if client not in self.contexts:
                context = self.contexts[client] = self.make_context(f"client-{client}", f"client-{client}-{os.urandom(8).hex()}")
                asyncio.run(self.model.on_episode_start({"task": {"name": task}}, context))
            context = self.contexts[client]
            result = self.model.predict(observation, context)
        actions = result.get("actions", result.get("action"))
        if actions is None:
            raise RuntimeError(f"predict returned {', '.join(result)}, and no actions")
        actions = np.atleast_2d(np.asarray(actions, np.float32))
        # As vla-eval cuts a chunk: to the session's size where the class sets one.
        sizes = getattr(self.model, "_session_chunk_sizes", {})
        actions = actions[: sizes.get(context.session_id, self.model.chunk_size)]
        for _ in range(len(actions)):  # vla-eval counts observations: one a row, if the client plays them all
            context._increment_step()
        if self.binary_gripper:
            actions = np.concatenate([actions[:, :-1], np.where(actions[:, -1:] < 0, -1, 1)], axis=1)
        return actions


def make_parser():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model-server", required=True, metavar="MODULE:CLASS", help="or FILE.py:CLASS")
    parser.add_argument("--arg", action="append", default=[], metavar="NAME=VALUE",
                        help="of the class, as under `args` in vla-eval's files; VALUE is JSON, else text")
    parser.add_argument("--camera", action="append", default=[], metavar="NAME=KEY",
                        help="a view's name for the model, and the message's key (default: LIBERO's: "
                        "agentview=observation/image, and wrist=observation/wrist_image where the class wants it)")
    parser.add_argument("--view-side", type=whole(1, 8192), default=256,
                        help="of the views that clients are asked for; others are taken (default: 256, vla-eval's)")
    parser.add_argument("--state-dim", type=whole(1, 4096), default=8, help="numbers of `states` (default: 8, LIBERO's)")
    parser.add_argument("--turn", choices=TURNS, default="none", help="what is done to views (default: none)")
    parser.add_argument("--binary-gripper", action="store_true",
                        help="the last number of an action by its sign, as vla-eval's LIBERO benchmark plays it")
    add_server_options(parser)
    return parser


if __name__ == "__main__":
    sys.exit(run(VlaEvalModel, make_parser().parse_args()))
