#!/usr/bin/env python3
"""Serves a LeRobot policy on openpi's WebSocket wire, from the environment that LeRobot runs in.

    pip install websockets msgpack        # beside lerobot, 0.3 or newer; nothing of RoboStress
    python robostress_serve_lerobot.py --policy FOLDER_OR_HUB_NAME --device cuda

openpi's clients, and `robostress sweep --policy-url ws://127.0.0.1:8000`, then ask it as they ask
openpi's own server. The policy runs with the processors that were saved with it (LeRobot 0.4 and
newer; before, a policy normalises inside).

The wire. Binary msgpack with NumPy arrays, one answer for each message. The server speaks first:
a map with `extensions`, `policies` (one: `name`, `cameras`, `state_dim`, `action_dim`,
`action_horizon`, `image_width`, `image_height`, `resizes_images`, `max_view_side`, and more) and
`model` (`sha256` over weights, configuration and statistics). A message holds

    a view      uint8 [H, W, 3] or [3, H, W], a key for each camera: "observation/image",
                {"images": {"cam_high": ...}}; --camera-map says which is which
    a state     [state_dim] numbers, units and order of the policy's own data: "observation/state",
                "state", or DROID's "observation/joint_position" and "observation/gripper_position"
    prompt      the instruction, for policies that read one
    seed        optional, 0 to 2^63 - 1: draws the sampling noise of this answer, and of this answer
                only, from torch's generators seeded with it. The same seed and observation give the
                same actions on one machine with one version of torch. A policy that draws elsewhere
                is found out at the start, and then `extensions` have no `seed`
    reset       optional, true: a new episode. Alone, it is answered {"reset": True}

and is answered {"actions": float32 [action_horizon, action_dim], "policy_timing", "server_timing"},
actions in the units of the policy's data. What cannot be answered is answered by one line of text,
and the connection ends with 1011, as openpi's does. GET /healthz says OK.

Chunks come from `predict_action_chunk`. `select_action`, called H times on one observation, would
not give one: a policy without `predict_action_chunk`, or with a history (diffusion, VQ-BeT), wants
a new observation at every control step. Such a policy is served by --every-step: one row an answer,
one client at a time, who must ask at every control step.
"""

import argparse
import asyncio
import contextlib
import hashlib
import hmac
import ipaddress
import json
import logging
import os
import random
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from http import HTTPStatus
from importlib.metadata import PackageNotFoundError, version

import msgpack
import numpy as np

LOG = logging.getLogger("robostress")
SEEDS = 2**63
# LeRobot's names of LIBERO's two views (lerobot/envs/libero.py), and openpi's keys of the same.
LIBERO_KEYS = {"image2": ["observation/wrist_image"]}
STATE_KEYS = (
    ("observation/state",),
    ("observation.state",),
    ("state",),
    ("observation/joint_position", "observation/gripper_position"),
)
TASK_KEYS = ("prompt", "task", "task_description")


class Refused(ValueError):
    """A message or an option that cannot be used; its text goes to whoever sent it."""


@contextlib.contextmanager
def drawn_from(seed):
    """Noise of Python, NumPy and torch that follows from `seed`; None: as it comes.

    Afterwards the generators go on as if nothing had been drawn: other answers are not touched.
    """
    if seed is None:
        yield
        return
    torch, states = sys.modules.get("torch"), (random.getstate(), np.random.get_state())
    devices = list(range(torch.cuda.device_count())) if torch and torch.cuda.is_initialized() else []
    with torch.random.fork_rng(devices=devices) if torch else contextlib.nullcontext():
        try:
            random.seed(seed)
            np.random.seed(seed % 2**32)
            if torch:
                torch.manual_seed(seed)
            yield
        finally:
            random.setstate(states[0])
            np.random.set_state(states[1])


def obeys_seed(ask):
    """Whether ask() gives the same twice, and what it gave; called with the same seed each time."""
    first, second = ask(), ask()
    same = np.abs(first - second).max() <= 0.01 * np.abs(first).max()  # a GPU's sums are not exact
    if not same:
        LOG.warning("the policy's noise does not follow torch's seed: seed is not among its extensions")
    return first, ["reset"] + ["seed"] * bool(same)


# --- msgpack with NumPy arrays ---------------------------------------------------------------------


def _encode(value):
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise ValueError(f"an array of {value.dtype} does not travel")
        return {
            b"__ndarray__": True,
            b"data": value.tobytes(),
            b"dtype": value.dtype.str,
            b"shape": value.shape,
        }
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not travel")


def _decode(entries):
    entries = {key.decode() if isinstance(key, bytes) else key: value for key, value in entries.items()}
    if "__npgeneric__" in entries:
        dtype = _dtype(entries)
        return dtype.type(entries.get("data"))
    if "__ndarray__" not in entries:
        return entries
    dtype, shape, data = _dtype(entries), entries.get("shape"), entries.get("data")
    if not isinstance(data, bytes) or not isinstance(shape, list) or len(shape) > 8:
        raise Refused("an array wants data as bytes and a shape of at most 8 numbers")
    items = 1
    for size in shape:
        if type(size) is not int or not 0 <= size <= len(data):
            raise Refused(f"an array of {len(data)} bytes cannot have the shape {shape}")
        items *= size
    if items * dtype.itemsize != len(data):
        raise Refused(f"an array {shape} of {dtype} has {items * dtype.itemsize} bytes, {len(data)} came")
    return np.frombuffer(data, dtype=dtype).reshape(shape)


def _dtype(entries):
    name = entries.get("dtype")
    try:
        dtype = np.dtype(name) if isinstance(name, str) and len(name) < 16 else None
    except TypeError:
        dtype = None
    if dtype is None or dtype.kind not in "biuf":
        raise Refused(f"an array's dtype is {name!r:.40}; |b1, |u1, <i8, <f4, <f8 and their like travel")
    return dtype


def pack(value):
    return msgpack.packb(value, default=_encode, use_bin_type=True)


def unpack(message):
    """The map in a client's message [bytes]. Refused: what is not one, and why."""
    if not isinstance(message, bytes):
        raise Refused("a text came; a message is binary msgpack")
    try:
        value = msgpack.unpackb(
            message,
            object_hook=_decode,
            raw=False,
            strict_map_key=True,
            max_str_len=1 << 16,
            max_array_len=1 << 16,
            max_map_len=1 << 10,
            max_ext_len=0,
        )
    except Refused:
        raise
    except Exception as error:  # msgpack raises a dozen kinds
        raise Refused(f"the message of {len(message)} bytes is no msgpack: {error or type(error).__name__}")
    if not isinstance(value, dict):
        raise Refused(f"a message is a map; a {type(value).__name__} came")
    return value


# --- An observation, checked -------------------------------------------------------------------------


def find(message, path):
    """The value under "a/b": a key of that name, else key b of the map a. None: there is none."""
    if path in message:
        return message[path]
    head, _, tail = path.partition("/")
    inner = message.get(head) if tail else None
    return find(inner, tail) if isinstance(inner, dict) else None


def paths(message, depth=3):
    """The first keys of a message, for an error."""
    found = []
    for key, value in list(message.items())[:40]:
        inner = paths(value, depth - 1) if isinstance(value, dict) and depth else []
        found += [f"{key}/{name}" for name in inner] or [str(key)[:60]]
    return found[:40]


def read_bool(message, key):
    value = message.get(key, False)
    if not isinstance(value, (bool, np.bool_)):
        raise Refused(f"{key}: is {value!r:.40}, must be true or false")
    return bool(value)


def read_seed(message):
    """None: the message has none."""
    seed = message.get("seed")
    if seed is None:
        return None
    if isinstance(seed, (bool, np.bool_)) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < SEEDS:
        raise Refused(f"seed: is {seed!r:.40}, must be a whole number from 0 to 2^63 - 1")
    return int(seed)


def read_text(message, keys):
    for key in keys:
        text = find(message, key)
        if text is None:
            continue
        if not isinstance(text, str):
            raise Refused(f"{key}: is {type(text).__name__}, must be text")
        return text
    return None


class Camera:
    """A view that a policy wants.

    feature: its name for the policy. height, width [pixels]: None where the policy declares none.
    keys: where a message may hold it, the first that is there counts.
    """

    def __init__(self, feature, height=None, width=None, key=None):
        self.feature, self.height, self.width = feature, height, width
        self.name = feature.removeprefix("observation.images.").removeprefix("observation.")
        if key is not None:
            self.keys = [key]
        else:
            self.keys = LIBERO_KEYS.get(self.name, []) + [f"observation/{self.name}", f"images/{self.name}"]
            self.keys += [f"observation.images.{self.name}", self.name]


TURNS = {
    "none": lambda view: view,
    "rotate-180": lambda view: view[::-1, ::-1],
    "flip-vertical": lambda view: view[::-1],
    "flip-horizontal": lambda view: view[:, ::-1],
}


class ObservationReader:
    """Reads what a policy wants out of a message, and refuses what does not fit.

    state_dim: 0 where the policy reads no state. state_keys: parts in a row; None: those of openpi's
    clients. reads_task: a message without an instruction is refused. any_size: views of other sizes
    than the camera's are taken.
    """

    def __init__(self, cameras, state_dim, reads_task, *, state_keys=None, task_key=None, turn="none",
                 any_size=False, max_view_side=1280):
        self.cameras, self.state_dim, self.reads_task = cameras, state_dim, reads_task
        self.state_keys = [tuple(state_keys)] if state_keys else STATE_KEYS
        self.task_keys = (task_key,) if task_key else TASK_KEYS
        self.turn, self.any_size, self.max_view_side = turn, any_size, max_view_side

    def read(self, message):
        """{feature: uint8 [H, W, 3], C-contiguous}, float32 [state_dim] or None, instruction."""
        views = {camera.feature: self._view(message, camera) for camera in self.cameras}
        state = self._state(message) if self.state_dim else None
        task = read_text(message, self.task_keys)
        if task is None and self.reads_task:
            raise Refused(f"{self.task_keys[0]}: is not in the message; the policy reads an instruction")
        return views, state, task or ""

    def holds_observation(self, message):
        keys = [key for camera in self.cameras for key in camera.keys]
        keys += [key for parts in self.state_keys for key in parts]
        return any(find(message, key) is not None for key in keys)

    def _view(self, message, camera):
        key, view = next(
            ((key, view) for key in camera.keys if (view := find(message, key)) is not None), (None, None)
        )
        if view is None:
            raise Refused(
                f"{camera.keys[0]}: is not in the message, and the policy's camera {camera.name} wants it. The "
                f"message holds {', '.join(paths(message)) or 'nothing'}. Looked for: {', '.join(camera.keys)}. "
                f"The server's --camera-map KEY={camera.name} names another key"
            )
        if not isinstance(view, np.ndarray) or view.dtype != np.uint8 or view.ndim != 3:
            what = f"{view.dtype} {list(view.shape)}" if isinstance(view, np.ndarray) else type(view).__name__
            raise Refused(f"{key}: is {what}, must be uint8 [H, W, 3] or [3, H, W], colours from 0 to 255")
        if view.shape[2] != 3 and view.shape[0] == 3:
            view = view.transpose(1, 2, 0)
        if view.shape[2] != 3:
            raise Refused(f"{key}: has the shape {list(view.shape)}, must be [H, W, 3] or [3, H, W]")
        height, width = view.shape[:2]
        if not 1 <= min(height, width) <= max(height, width) <= self.max_view_side:
            raise Refused(f"{key}: is {height} x {width}, sides are 1 to {self.max_view_side}: --max-view-side")
        if not self.any_size and camera.height and (height, width) != (camera.height, camera.width):
            raise Refused(
                f"{key}: is {height} x {width}, the policy was trained on {camera.height} x {camera.width}. Send "
                f"that, or start the server with --resize stretch, pad or as-is"
            )
        return np.array(TURNS[self.turn](view), order="C")  # a copy: the message's bytes cannot be written

    def _state(self, message):
        for keys in self.state_keys:
            parts = [find(message, key) for key in keys]
            if all(part is not None for part in parts):
                break
        else:
            raise Refused(
                f"{self.state_keys[0][0]}: is not in the message, and the policy wants a state of {self.state_dim} "
                f"numbers. The message holds {', '.join(paths(message)) or 'nothing'}. The server's --state-keys "
                f"names other keys"
            )
        flat = []
        for key, part in zip(keys, parts):
            part = np.asarray(part)
            if part.dtype.kind not in "iuf" or part.ndim > 1:
                raise Refused(f"{key}: is {part.dtype} {list(part.shape)}, must be a row of numbers")
            flat.append(np.atleast_1d(part))
        state, name = np.concatenate(flat), " and ".join(keys)
        if state.shape != (self.state_dim,):
            raise Refused(f"{name}: holds {state.size} numbers, the policy wants {self.state_dim}")
        if not np.isfinite(state).all():
            raise Refused(f"{name}: number {int(np.argmin(np.isfinite(state)))} is not finite")
        return state.astype(np.float32)


def read_camera_map(entries, features):
    """--camera-map's KEY=CAMERA entries: {the policy's feature: the message's key}."""
    keys = {}
    for entry in entries:
        key, _, name = entry.rpartition("=")
        matching = [f for f in features if name in (f, Camera(f).name)]
        if not key or not matching:
            raise Refused(
                f"--camera-map {entry}: must be KEY=CAMERA, with a camera of the policy: "
                f"{', '.join(Camera(f).name for f in features) or 'it has none'}"
            )
        if matching[0] in keys:
            raise Refused(f"--camera-map {entry}: {name} has a key already, {keys[matching[0]]}")
        keys[matching[0]] = key
    return keys


# --- LeRobot -------------------------------------------------------------------------------------------


def file_digest(path):
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def model_identity(folder):
    """What decides a policy's answers, by content: weights, statistics, configuration.

    {"sha256": of all, "files": {name: SHA-256}}, files of the folder itself. Refused without weights.
    """
    names = sorted(n for n in os.listdir(folder) if n.endswith((".safetensors", ".json", ".bin")))
    if not any(n.endswith((".safetensors", ".bin")) and not n.startswith(("policy_pre", "policy_post")) for n in names):
        raise Refused(f"--policy {folder}: holds no weights (model.safetensors); it holds {', '.join(names[:20]) or 'nothing'}")
    files = {name: file_digest(os.path.join(folder, name)) for name in names}
    lines = "".join(f"{digest}  {name}\n" for name, digest in files.items())
    return {"sha256": hashlib.sha256(lines.encode()).hexdigest(), "files": files}


def policy_folder(name, revision):
    """A folder with the policy: `name` itself, else the hub's snapshot of it, in LeRobot's cache."""
    if os.path.isdir(name):
        return os.path.abspath(name)
    if os.path.exists(name) or name.startswith((".", "/", "~")) or name.count("/") != 1:
        raise Refused(f"--policy {name}: is neither a folder nor a name of the hub, OWNER/NAME")
    from huggingface_hub import snapshot_download

    try:
        return snapshot_download(name, revision=revision, ignore_patterns=["*/*", "*.md"])
    except Exception as error:
        raise Refused(f"--policy {name}: is no folder here, and the hub says: {error}")


def read_overrides(entries):
    """--override STEP.FIELD=VALUE entries: {step: {field: value}}; VALUE is JSON, else text."""
    overrides = {}
    for entry in entries:
        name, separator, text = entry.partition("=")
        step, dot, field = name.partition(".")
        if not (separator and dot and step and field):
            raise Refused(f"--override {entry}: must be STEP.FIELD=VALUE")
        try:
            value = json.loads(text)
        except ValueError:
            value = text
        overrides.setdefault(step, {})[field] = value
    return overrides


def installed(package):
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


class LeRobotPolicy:
    """A PreTrainedPolicy with its processors, as `serve` wants a policy. Used by one thread.

    metadata: what the wire's first message says of it. exclusive: one client at a time.
    """

    def __init__(self, options):
        folder = policy_folder(options.policy, options.revision)
        if os.path.exists(os.path.join(folder, "adapter_config.json")):
            raise Refused(f"--policy {folder}: is a PEFT adapter; merge it into its base and save that")
        identity = model_identity(folder)
        import torch  # seconds, so after what can be refused without

        self.torch = torch
        try:
            self.device = torch.device(options.device)
            torch.zeros(1, device=self.device)
        except Exception as error:
            raise Refused(f"--device {options.device}: torch cannot use it: {error}")
        self._load(folder, read_overrides(options.override))
        config, self.exclusive = self.policy.config, options.every_step
        if (getattr(config, "n_obs_steps", 1) or 1) > 1 and not options.every_step:
            raise Refused(
                f"--policy {folder}: {config.type} looks at {config.n_obs_steps} observations of consecutive control "
                f"steps, and a client that plays chunks sends every {config.n_action_steps}th. Start the server with "
                f"--every-step and let the client ask at every control step (execute_steps 1)"
            )
        self.reader = self._reader(options, folder)
        self.resize = options.resize
        self.rows = None
        actions, extensions = obeys_seed(lambda: self._warm_up(folder))
        if options.action_chunk is not None:
            if not 1 <= options.action_chunk <= len(actions):
                raise Refused(f"--action-chunk {options.action_chunk}: the policy's chunk has {len(actions)} rows")
            self.rows = options.action_chunk
        cameras = self.reader.cameras
        self.metadata = {
            "server": "robostress_serve_lerobot",
            "extensions": extensions,
            "policies": [
                {
                    "name": options.name or os.path.basename(options.policy.rstrip("/")),
                    "cameras": [camera.name for camera in cameras],
                    "camera_keys": [camera.keys[0] for camera in cameras],
                    "state_dim": self.reader.state_dim,
                    "action_dim": int(actions.shape[1]),
                    "action_horizon": self.rows or len(actions),
                    "n_action_steps": int(getattr(config, "n_action_steps", 0) or 0),
                    "image_width": cameras[0].width if cameras else 0,
                    "image_height": cameras[0].height if cameras else 0,
                    "resizes_images": self.reader.any_size,
                    "max_view_side": options.max_view_side,
                    "every_step": options.every_step,
                }
            ],
            "model": {
                "type": config.type,
                **identity,
                "device": str(self.device),
                "versions": {"lerobot": installed("lerobot"), "torch": torch.__version__},
            },
        }

    def _load(self, folder, overrides):
        from lerobot.policies import factory  # first: it registers the configurations

        from lerobot.configs.policies import PreTrainedConfig

        try:
            config = PreTrainedConfig.from_pretrained(folder)
        except Exception as error:
            raise Refused(f"--policy {folder}: LeRobot {installed('lerobot')} cannot read its config.json: {error}")
        config.device = str(self.device)
        try:
            self.policy = factory.get_policy_class(config.type).from_pretrained(folder, config=config)
            self.policy.to(self.device).eval()
        except Exception as error:
            LOG.exception("%s", folder)
            what = f"{type(error).__name__}: {' '.join(str(error).split())[:400]}"
            raise Refused(f"--policy {folder}: LeRobot {installed('lerobot')} cannot load this {config.type}: {what}")
        self.preprocess = self.postprocess = None
        if not hasattr(factory, "make_pre_post_processors"):  # before 0.4: inside the policy
            if overrides:
                raise Refused(f"--override: LeRobot {installed('lerobot')} has no processors")
            return
        with_device = os.path.join(folder, "policy_preprocessor.json")
        if os.path.exists(with_device) and '"device_processor"' in open(with_device, encoding="utf-8").read():
            overrides.setdefault("device_processor", {}).setdefault("device", str(self.device))
        try:
            self.preprocess, self.postprocess = factory.make_pre_post_processors(
                self.policy.config, pretrained_path=folder, preprocessor_overrides=overrides
            )
        except FileNotFoundError as error:
            raise Refused(
                f"--policy {folder}: has no processors beside its weights ({error}). A checkpoint from before LeRobot "
                f"0.4 gets them by python -m lerobot.processor.migrate_policy_normalization --pretrained-path {folder}"
            )

    def _reader(self, options, folder):
        config, sizes, state_dim = self.policy.config, {}, 0
        for feature, declared in config.input_features.items():
            kind, shape = declared.type.value, tuple(declared.shape)
            if kind == "VISUAL":
                if len(shape) != 3 or 3 not in (shape[0], shape[2]):
                    raise Refused(f"--policy {folder}: {feature} has the shape {shape}; views of 3 colours are served")
                sizes[feature] = shape[1:] if shape[0] == 3 else shape[:2]
            elif feature == "observation.state" and len(shape) == 1:
                state_dim = shape[0]
            else:
                raise Refused(f"--policy {folder}: wants {feature} ({kind} {shape}), which openpi's wire has not")
        for name in options.without_camera:
            found = [f for f in sizes if name in (f, Camera(f).name)]
            if not found:
                raise Refused(f"--without-camera {name}: the policy has {', '.join(Camera(f).name for f in sizes)}")
            del sizes[found[0]]
        # LeRobot's own placeholders: the policy masks them itself.
        sizes = {f: size for f, size in sizes.items() if not Camera(f).name.startswith("empty_camera_")}
        keys = read_camera_map(options.camera_map, list(sizes))
        if options.state_dim is not None and options.state_dim != state_dim:
            raise Refused(f"--state-dim {options.state_dim}: the policy's observation.state has {state_dim} numbers")
        steps = getattr(self.preprocess, "steps", ())
        reads_task = hasattr(config, "tokenizer_max_length") or any(
            "tokeniz" in type(step).__name__.lower() for step in steps
        )
        # Policies that bring a view to their own size, with padding.
        resizes = bool(getattr(config, "resize_imgs_with_padding", None) or getattr(config, "image_resolution", None))
        return ObservationReader(
            [Camera(f, *size, keys.get(f)) for f, size in sizes.items()],
            state_dim,
            reads_task,
            state_keys=options.state_keys,
            task_key=options.task_key,
            turn=options.turn,
            any_size=resizes or options.resize != "refuse",
            max_view_side=options.max_view_side,
        )

    def _warm_up(self, folder):
        """One answer to a black picture: compiles, and says how many rows and columns there are."""
        views = {c.feature: np.zeros((c.height, c.width, 3), np.uint8) for c in self.reader.cameras}
        state = np.zeros(self.reader.state_dim, np.float32) if self.reader.state_dim else None
        try:
            actions = self._actions(views, state, "warm up", seed=0)
        except NotImplementedError:
            raise Refused(
                f"--policy {folder}: {self.policy.config.type} has no predict_action_chunk, so there is no chunk. "
                f"select_action on one observation again and again is not one: each call wants a new observation. "
                f"Start the server with --every-step and let the client ask at every control step (execute_steps 1)"
            )
        self.reset()
        return actions

    def forget(self, client):
        pass  # an observation is all that a chunk follows from

    def reset(self, client=None):
        self.policy.reset()
        for processor in (self.preprocess, self.postprocess):
            if hasattr(processor, "reset"):
                processor.reset()

    def infer(self, message, seed, client):
        """float32 [rows, action_dim], in the units of the policy's data."""
        return self._actions(*self.reader.read(message), seed)[: self.rows]

    def _tensor(self, view, camera):
        """uint8 [H, W, 3] -> float32 [1, 3, H, W] from 0 to 1, as LeRobot's own clients hand views over."""
        functional = self.torch.nn.functional
        image = self.torch.from_numpy(view).to(self.device).permute(2, 0, 1).unsqueeze(0).float() / 255
        size, wanted = tuple(image.shape[2:]), (camera.height, camera.width)
        if size == wanted or self.resize not in ("stretch", "pad"):
            return image.contiguous()
        ratio = min(w / s for w, s in zip(wanted, size))
        scaled = wanted if self.resize == "stretch" else tuple(max(1, round(s * ratio)) for s in size)
        image = functional.interpolate(image, size=scaled, mode="bilinear", align_corners=False, antialias=True)
        top, left = ((w - s) // 2 for w, s in zip(wanted, scaled))
        padding = (left, wanted[1] - scaled[1] - left, top, wanted[0] - scaled[0] - top)
        return functional.pad(image.clamp(0, 1), padding).contiguous()

    def _actions(self, views, state, task, seed):
        torch = self.torch
        cameras = {camera.feature: camera for camera in self.reader.cameras}
        batch = {feature: self._tensor(view, cameras[feature]) for feature, view in views.items()}
        if state is not None:
            batch["observation.state"] = torch.from_numpy(state).unsqueeze(0).to(self.device)
        batch["task"] = task if self.preprocess else [task]
        batch["robot_type"] = ""
        half = torch.autocast(self.device.type, enabled=bool(getattr(self.policy.config, "use_amp", False)))
        with torch.inference_mode(), half, drawn_from(seed):
            if self.preprocess:
                batch = self.preprocess(batch)
            if self.exclusive:
                actions = self.policy.select_action(batch).unsqueeze(1)
            else:
                actions = self.policy.predict_action_chunk(batch)
            if self.postprocess:
                actions = self.postprocess(actions)
        actions = actions.detach().to("cpu", torch.float32).numpy()
        if actions.ndim != 3 or actions.shape[0] != 1:
            raise RuntimeError(f"the policy answered actions {list(actions.shape)}, must be [1, rows, columns]")
        return actions[0]


# --- The server -----------------------------------------------------------------------------------------


class Server:
    """Answers openpi's clients with a policy.

    policy: `metadata` (map), `exclusive` (one client at a time), `reader.holds_observation(message)`,
    `reset(client)`, `infer(message, seed, client)` -> float32 [rows, columns], `forget(client)`, where
    a client is a number. All calls come from one thread, one after the other, so that the event loop
    goes on answering pings and /healthz.
    """

    def __init__(self, policy, options):
        self.policy, self.options = policy, options
        self.metadata = pack(policy.metadata)
        self.worker = ThreadPoolExecutor(1, thread_name_prefix="policy")
        self.clients = self.greeted = 0
        self.key = read_key(options.api_key_file)

    def check_request(self, connection, request):
        """websockets' process_request: a response, or None to go on to the upgrade."""
        if request.path == "/healthz":
            return connection.respond(HTTPStatus.OK, "OK\n")
        if self.key is None:
            return None
        given = request.headers.get_all("Authorization")
        if len(given) == 1 and hmac.compare_digest(given[0].encode("utf-8", "replace"), b"Api-Key " + self.key):
            return None
        return connection.respond(HTTPStatus.UNAUTHORIZED, "send the header Authorization: Api-Key KEY\n")

    def answer(self, message, client, previous_ms):
        """The bytes that answer a message."""
        begin = time.monotonic()
        observation = unpack(message)
        seed = read_seed(observation)
        if seed is not None and "seed" not in self.policy.metadata["extensions"]:
            raise Refused("seed: this policy draws its noise where a seed does not reach; leave it out")
        if read_bool(observation, "reset"):
            self.policy.reset(client)
            if not self.policy.reader.holds_observation(observation):
                return pack({"reset": True})
        actions = self.policy.infer(observation, seed, client)
        infer_ms = 1e3 * (time.monotonic() - begin)
        actions = np.ascontiguousarray(actions, np.float32)
        if actions.ndim != 2 or not actions.size:
            raise RuntimeError(f"the policy answered actions {list(actions.shape)}, must be [rows, columns]")
        if not np.isfinite(actions).all():
            row, column = np.argwhere(~np.isfinite(actions))[0]
            raise RuntimeError(f"the policy's action {row}, number {column}, is {actions[row, column]}")
        server = {"infer_ms": infer_ms} | ({} if previous_ms is None else {"prev_total_ms": previous_ms})
        return pack({"actions": actions, "policy_timing": {"infer_ms": infer_ms}, "server_timing": server})

    async def handle(self, socket):
        import websockets

        limit = 1 if self.policy.exclusive else self.options.max_connections
        if self.clients >= limit:
            try:
                await socket.send(f"this server takes {limit} client{'s' * (limit > 1)} at a time: try again later")
                await socket.close(1013, "full")
            except websockets.ConnectionClosed:
                pass
            return
        self.clients += 1
        self.greeted += 1
        client = self.greeted
        try:
            await self.converse(socket, client)
        except websockets.ConnectionClosed:
            pass
        finally:
            self.clients -= 1
            try:
                await asyncio.get_running_loop().run_in_executor(self.worker, self.policy.forget, client)
            except Exception:
                LOG.exception("%s: the end of its episode", socket.remote_address)

    async def converse(self, socket, client):
        loop, previous_ms = asyncio.get_running_loop(), None
        if self.policy.exclusive:
            await loop.run_in_executor(self.worker, self.policy.reset, client)
        await socket.send(self.metadata)
        while True:
            message = await socket.recv()
            begin = time.monotonic()
            try:
                reply = await loop.run_in_executor(self.worker, self.answer, message, client, previous_ms)
            except Exception as error:
                refused = isinstance(error, Refused)
                text = str(error) if refused else f"{type(error).__name__}: {error}"
                # One line, whatever a client's keys hold: it goes to a log and to a terminal.
                text = "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))[:4000]
                LOG.log(logging.WARNING if refused else logging.ERROR, "%s: %s", socket.remote_address, text,
                        exc_info=not refused)
                await socket.send(text)
                await socket.close(1011, "the text before this says why")
                return
            await socket.send(reply)
            previous_ms = 1e3 * (time.monotonic() - begin)

    async def run(self):
        from websockets.asyncio.server import serve

        options, loop, stopped = self.options, asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, stopped.set)
        # origins: a browser's page says where it comes from, and is refused.
        async with serve(
            self.handle,
            options.host,
            options.port,
            compression=None,
            max_size=options.max_message_mib << 20,
            max_queue=1,
            origins=[None],
            process_request=self.check_request,
        ) as server:
            port = server.sockets[0].getsockname()[1]
            LOG.info("serving %s at ws://%s:%d", self.policy.metadata["policies"][0]["name"], options.host, port)
            if options.port_file:
                with open(options.port_file + ".part", "w", encoding="utf-8") as file:
                    file.write(f"{port}\n")
                os.replace(options.port_file + ".part", options.port_file)
            await stopped.wait()
            LOG.info("stopping")
        self.worker.shutdown()


def read_key(path):
    """The API key in a file [bytes], without the white space around it. None: there is no file."""
    if path is None:
        return None
    try:
        with open(path, "rb") as file:
            key = file.read(4097).strip()
    except OSError as error:
        raise Refused(f"--api-key-file {path}: {error.strerror}")
    if not 16 <= len(key) <= 4096 or not key.isascii() or len(key.split()) != 1:
        raise Refused(f"--api-key-file {path}: must hold one key of 16 to 4096 characters, such as openssl rand -hex 32")
    return key


def is_loopback(host):
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


# --- The command line -------------------------------------------------------------------------------------


def whole(least, most):
    def read(text):
        number = int(text)
        if not least <= number <= most:
            raise argparse.ArgumentTypeError(f"{number} is not between {least} and {most}")
        return number

    return read


def add_server_options(parser):
    """Options of `Server`: where it listens, who may ask, how much."""
    parser.add_argument("--name", help="what the metadata call the policy (default: the last part of its path)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=whole(0, 65535), default=8000, help="0: a free one (default: 8000)")
    parser.add_argument("--port-file", help="file that gets the port once the server listens")
    parser.add_argument("--api-key-file", help="clients must send its key: Authorization: Api-Key KEY")
    parser.add_argument("--max-message-mib", type=whole(1, 1024), default=64, help="longer messages end the "
                        "connection with 1009 (default: 64)")
    parser.add_argument("--max-connections", type=whole(1, 1024), default=16, help="clients at a time (default: 16)")
    parser.add_argument("--max-view-side", type=whole(1, 8192), default=1280, help="of a view [pixels] (default: 1280)")


def make_parser():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", required=True, help="folder of a saved policy, or OWNER/NAME on the hub")
    parser.add_argument("--revision", help="of the hub's repository")
    parser.add_argument("--device", default="cuda", help="cuda, cuda:1, cpu, mps (default: cuda)")
    parser.add_argument("--camera-map", action="append", default=[], metavar="KEY=CAMERA",
                        help="the message's key of one of the policy's cameras: observation/wrist_image=image2. "
                        "Without it a camera NAME is observation/NAME, images/NAME, observation.images.NAME or NAME, "
                        "and LIBERO's image2 is observation/wrist_image")
    parser.add_argument("--without-camera", action="append", default=[], metavar="CAMERA",
                        help="not sent by clients; for policies that mask a missing view themselves (pi0, SmolVLA)")
    parser.add_argument("--state-keys", nargs="+", metavar="KEY", help="the message's keys of the state's parts, in a row")
    parser.add_argument("--state-dim", type=whole(0, 4096), help="refuse to start if the policy's state has another size")
    parser.add_argument("--task-key", help="the message's key of the instruction (default: prompt, task, "
                        "task_description)")
    parser.add_argument("--turn", choices=TURNS, default="none",
                        help="what is done to views. openpi's LIBERO clients send them turned by 180 degrees, as "
                        "LeRobot's LiberoProcessorStep hands them to a policy: none. From a client that sends them as "
                        "the simulator renders them: rotate-180 (default: none)")
    parser.add_argument("--resize", choices=("refuse", "stretch", "pad", "as-is"), default="refuse",
                        help="a view of another size than the policy declares. as-is: the policy gets it so. pi0 and "
                        "SmolVLA bring any size to their own (default: refuse)")
    parser.add_argument("--action-chunk", type=whole(1, 100000), metavar="N", help="send the first N rows (default: all)")
    parser.add_argument("--every-step", action="store_true", help="one row an answer, by select_action; see above")
    parser.add_argument("--override", action="append", default=[], metavar="STEP.FIELD=VALUE",
                        help="of the saved pre-processor: tokenizer_processor.tokenizer_name=FOLDER")
    add_server_options(parser)
    return parser


def run(make_policy, options):
    """Loads a policy and serves it until SIGTERM. The exit code."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s")
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # else a line, or a traceback, for each client
    try:
        import websockets.asyncio.server  # noqa: F401, to say so before a policy is loaded
    except ImportError:
        print("error: needs websockets 13 or newer: pip install 'websockets>=13' msgpack", file=sys.stderr)
        return 2
    try:
        read_key(options.api_key_file)
        if not is_loopback(options.host) and options.api_key_file is None:
            LOG.warning("--host %s: anybody who reaches it may ask, and nothing is encrypted: --api-key-file, or a "
                        "tunnel to --host 127.0.0.1", options.host)
        server = Server(make_policy(options), options)
    except Refused as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    try:
        asyncio.run(server.run())
    except OSError as error:
        print(f"error: --host {options.host} --port {options.port}: {error.strerror or error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(run(LeRobotPolicy, make_parser().parse_args()))
