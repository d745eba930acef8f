"""The suites of RoboStress as Gymnasium environments, with joint errors on.

    import robostress.gymnasium_suites
    env = gymnasium.make("robostress/TabletopGoal-v0", task=3, scenario="heavy_payload")
    env = gymnasium.make_vec("robostress/TabletopGoal-v0", num_envs=4, vectorization_mode="async", scenario="clean")

The simulator is the program `robostress-environment`, one process an environment: its initial states and its numbers are
those of `robostress sweep`, to the last bit. It comes with the package robostress-worker or a build; ROBOSTRESS_BIN names
its folder where it is not on PATH.
"""
import json
import os
import shutil
import subprocess
import tempfile

import gymnasium
import numpy

from robostress._library import InvalidArgument, NotFound, RobostressError, Unshared, WrongOrder, array, integer

SUITES = {"TabletopGoal": "tabletop_goal", "TabletopLong": "tabletop_long", "TabletopObject": "tabletop_object",
          "TabletopSpatial": "tabletop_spatial"}
TASKS, INITIAL_STATES = 10, 50  # of a suite, of a task
PROGRAM = "robostress-environment"
END_S = 5  # [s] for the program to end by itself


def _program():
    folder = os.environ.get("ROBOSTRESS_BIN")
    found = shutil.which(PROGRAM, path=folder)
    if found is None:
        raise NotFound(f"{PROGRAM} is not {'in ' + folder if folder else 'on PATH'}; install the package "
                       "robostress-worker, or name its folder in ROBOSTRESS_BIN")
    return found


class SuiteEnv(Unshared, gymnasium.Env):
    """One task of an embedded suite.

    Action [7]: displacement and turn in units of 0.05 m and 0.5 rad, gripper (-1 open, 1 closed); what is outside [-1, 1] is
    clipped. Observation: `pixels`, a picture [size, size, 3] of each camera, and `agent_pos` [8]: tool position [m], its turn
    from pointing straight down [rad], finger joints [m]. The reward is 1 at success, which ends the episode. `info`:
    `is_success`; `commanded` [7]; `measured`: joints `q` [rad], `dq` [rad/s], tool `position` [m] and `quaternion` [w, x, y, z],
    `gripper` opening [m].

    reset(seed=...) draws one of the 50 initial states, reset(options={"initial_state": 7}) names it.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}
    _process = None

    def __init__(self, suite="tabletop_goal", task=0, scenario="clean", severity=5, image_size=224, views=True,
                 settings=(), render_mode=None, camera_names=None):
        """`settings`: further "key=value" of a unit, such as "sim.goal_reference=desired". `camera_names`: what its two cameras
        are called in observations; None: as it calls them."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InvalidArgument(f"render_mode is {render_mode!r}, must be None or 'rgb_array'")
        command = [_program(), "--task", str(task), "--size", str(image_size)]
        for setting in (f"suite={suite}", f"scenario={scenario}", f"severity={severity}", *settings):
            command += ["--set", setting]
        self._said = tempfile.TemporaryFile()  # a pipe that nobody reads would stop the program once it is full
        self._owner = os.getpid()
        # A terminal's Ctrl-C is for Python; the program ends when its stdin does.
        self._process = subprocess.Popen(command + ([] if views else ["--no-views"]), stdin=subprocess.PIPE,
                                         stdout=subprocess.PIPE, stderr=self._said, start_new_session=True)
        said = self._line()
        self.task, self.task_description, self._max_episode_steps = said["name"], said["instruction"], said["horizon"]
        self.scenario, self.severity, self.render_mode = said["scenario"], said["severity"], render_mode
        self._cameras, self._size = list(camera_names or said["cameras"]), said["image_size"]
        if len(self._cameras) != len(said["cameras"]):
            self.close()
            raise InvalidArgument(f"camera_names is {camera_names!r}, must name {len(said['cameras'])} cameras")
        picture = gymnasium.spaces.Box(0, 255, (self._size, self._size, 3), numpy.uint8)
        spaces = {"agent_pos": gymnasium.spaces.Box(-numpy.inf, numpy.inf, (8,), numpy.float32)}
        if views:
            spaces["pixels"] = gymnasium.spaces.Dict({camera: picture for camera in self._cameras})
        self.observation_space = gymnasium.spaces.Dict(spaces)
        self.action_space = gymnasium.spaces.Box(-1, 1, (said["action_dim"],), numpy.float32)
        self._pictures, self._done = {}, True

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        state = (options or {}).get("initial_state")
        state = int(self.np_random.integers(INITIAL_STATES)) if state is None else integer("initial_state", state)
        observation, answer = self._ask({"reset": state})
        self._done = False
        return observation, {**self._info(answer), "initial_state": state}

    def step(self, action):
        if self._done:
            raise RobostressError("step comes after the episode's end or before its beginning; call reset")
        action = array("action", action, numpy.float32, *self.action_space.shape)
        if not numpy.isfinite(action).all():
            raise InvalidArgument(f"action is {action!r}, must be {self.action_space.shape[0]} finite numbers")
        command = numpy.clip(action, -1, 1)
        observation, answer = self._ask({"step": command.tolist()})
        success = answer["success"]
        truncated = not success and answer["step"] >= self._max_episode_steps
        self._done = success or truncated
        return observation, float(success), success, truncated, {**self._info(answer), "commanded": command}

    def render(self):
        if self.render_mode is None or not self._pictures:
            return None
        return numpy.concatenate(list(self._pictures.values()), axis=1)

    @property
    def alive(self):
        """Whether its program still plays: not closed, not ended by an error."""
        return self._process is not None and self._process.poll() is None

    def close(self):
        process, self._process = self._process, None
        if process is None or self._owner != os.getpid():
            return
        for pipe in (process.stdin, process.stdout):
            try:
                pipe.close()
            except OSError:
                pass
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._said.close()

    def __del__(self):
        self.close()

    def _ask(self, request):
        if self._process is None:
            raise RobostressError("the environment is closed: make another")
        if self._owner != os.getpid():
            raise WrongOrder(f"the environment is of process {self._owner}, this is {os.getpid()}: make another here")
        try:
            answer, data = self._exchange(request)
        except BaseException:  # also Ctrl-C: the answer would be taken for that to the next request
            self.close()
            raise
        if "error" in answer:
            raise InvalidArgument(answer["error"])
        pictures = numpy.frombuffer(data, numpy.uint8).reshape(-1, self._size, self._size, 3)
        self._pictures = {camera: picture.copy() for camera, picture in zip(self._cameras, pictures)}
        observation = {"agent_pos": numpy.asarray(answer["agent_pos"], numpy.float32)}
        if self._pictures:
            observation["pixels"] = dict(self._pictures)
        return observation, answer

    def _exchange(self, request):
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:
            pass  # what it said last is read below
        answer = self._line()
        size = answer.get("image_bytes", 0)
        data = self._process.stdout.read(size)
        if len(data) != size:
            self._fail()
        return answer, data

    def _line(self):
        line = self._process.stdout.readline()
        if not line:
            self._fail()
        return json.loads(line)

    def _fail(self):
        code = self._process.wait()
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip()
        self.close()
        kind = InvalidArgument if code in (1, 2) and said else RobostressError
        raise kind(said or f"{PROGRAM} ended with {code}")

    @staticmethod
    def _info(answer):
        measured = {key: numpy.asarray(value) for key, value in answer["state"].items()}
        return {"is_success": answer["success"], "measured": measured}


for _name, _suite in SUITES.items():
    gymnasium.register(f"robostress/{_name}-v0", entry_point="robostress.gymnasium_suites:SuiteEnv",
                       kwargs={"suite": _suite}, order_enforce=False, disable_env_checker=True)
