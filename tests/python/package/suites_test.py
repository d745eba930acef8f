"""The embedded suites as Gymnasium environments, beside the worker of a sweep."""
import copy
import gc
import json
import os
import pathlib
import pickle
import signal
import subprocess
import sys
import tempfile
import time
import unittest
import unittest.mock

import gymnasium
import numpy
from gymnasium.utils.env_checker import check_env

import robostress
import robostress.gymnasium_suites  # noqa: F401, names them to Gymnasium

BIN = pathlib.Path(os.environ["ROBOSTRESS_BIN"])
GOAL = "robostress/TabletopGoal-v0"
SLOW_PROGRAM = """#!{python} -S
import json, sys, time
def say(**said):
    print(json.dumps(said), flush=True)
say(name="t", instruction="i", horizon=100, scenario="clean", severity=5, cameras=[], image_size=32, action_dim=7)
for line in sys.stdin:
    if "step" in line:
        time.sleep(1.5)
    say(image_bytes=0, agent_pos=[0] * 8, success=False, step=1, state=dict(q=[0]))
"""


def tensors(file):
    """Of a safetensors file: a header of JSON behind its length, then the numbers."""
    data = file.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8:8 + size])
    kinds = {"F64": numpy.float64, "F32": numpy.float32, "I64": numpy.int64, "I32": numpy.int32, "U8": numpy.uint8}
    return header, {name: numpy.frombuffer(data, kinds[entry["dtype"]], offset=8 + size + entry["data_offsets"][0],
                                           count=int(numpy.prod(entry["shape"]))).reshape(entry["shape"])
                    for name, entry in header.items() if name != "__metadata__"}


class Suites(unittest.TestCase):
    def make(self, **arguments):
        env = gymnasium.make(GOAL, **{"image_size": 32, **arguments})
        self.addCleanup(env.close)
        return env

    def test_gymnasium_finds_nothing_wrong(self):
        env = self.make(render_mode="rgb_array")
        check_env(env.unwrapped, skip_render_check=True)
        env.reset(seed=1)
        self.assertEqual(env.render().shape, (32, 64, 3))
        self.assertGreater(env.render().std(), 5)

    def test_an_episode_is_the_sweeps_to_the_last_bit(self):
        with tempfile.TemporaryDirectory() as folder:
            made = subprocess.run([BIN / "robostress-worker", "--out", folder, "--record-joints", "--quiet", "--set",
                                   "suite=tabletop_goal", "--set", "policy=expert", "--set", "tasks=[3]", "--set",
                                   "episodes=1", "--set", "scenario=heavy_payload", "--set", "first_initial_state=7"],
                                  stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
            self.assertEqual(made.returncode, 0, made.stdout)
            header, joints = tensors(next(pathlib.Path(folder).glob("joints/*.safetensors")))
        env = self.make(task=3, scenario="heavy_payload", views=False)
        _, info = env.reset(options={"initial_state": 7})
        actions, q = joints["actions"], joints["step_q"]
        for step, action in enumerate(actions):
            numpy.testing.assert_array_equal(info["measured"]["q"], q[step], str(step))
            _, reward, terminated, _, info = env.step(action)
        numpy.testing.assert_array_equal(info["measured"]["q"], q[-1])
        self.assertGreater(len(actions), 30)
        self.assertEqual(terminated, header["__metadata__"]["success"] == "1")
        self.assertEqual(reward, float(terminated))

    def test_errors_move_the_arm_and_a_state_can_be_named(self):
        ends = {}
        for scenario in ("clean", "aged_joint_uniform"):
            env = self.make(scenario=scenario, views=False)
            first, info = env.reset(options={"initial_state": 12})
            again, _ = env.reset(options={"initial_state": 12})
            numpy.testing.assert_array_equal(first["agent_pos"], again["agent_pos"])
            self.assertEqual(info["initial_state"], 12)
            for _ in range(20):
                _, _, _, _, info = env.step([1, 0, -2, 0, 0, 0, 1])
            self.assertEqual(info["commanded"][2], -1)
            ends[scenario] = info["measured"]["position"]
        self.assertGreater(numpy.abs(ends["clean"] - ends["aged_joint_uniform"]).max(), 1e-3)

    def test_many_at_a_time(self):
        envs = gymnasium.make_vec(GOAL, num_envs=2, vectorization_mode="async", image_size=16, scenario="clean")
        self.addCleanup(envs.close)
        seen, _ = envs.reset(seed=[1, 2])
        self.assertEqual(seen["pixels"]["agentview"].shape, (2, 16, 16, 3))
        seen, reward, _, _, info = envs.step(numpy.zeros((2, 7), numpy.float32))
        self.assertEqual(reward.shape, (2,))
        self.assertEqual(info["is_success"].tolist(), [False, False])

    def test_an_episode_ends_at_its_horizon(self):
        env = self.make(views=False, settings=["horizon=3"])
        env.reset(seed=1)
        ends = [env.step(numpy.zeros(7))[3] for _ in range(3)]
        self.assertEqual(ends, [False, False, True])
        with self.assertRaisesRegex(robostress.RobostressError, "call reset"):
            env.step(numpy.zeros(7))

    def test_bad_input_says_what_is_wrong(self):
        for arguments, message in (({"task": 11}, "tasks are 0 to 9"), ({"scenario": "rain"}, "known: clean"),
                                   ({"severity": 9}, "severity"), ({"image_size": 4}, "size"),
                                   ({"settings": ["sim.goal=1"]}, "sim"), ({"render_mode": "human"}, "rgb_array")):
            with self.assertRaisesRegex(robostress.InvalidArgument, message):
                robostress.gymnasium_suites.SuiteEnv(**arguments)
        env = self.make(views=False)
        env.reset(seed=3)
        for action, message in ((numpy.zeros(6), r"action has shape \[6\], must be \[7\]"), ("up", "action: .* must be numbers"),
                                (numpy.full(7, numpy.nan), "must be 7 finite numbers"), ([[0], [0, 1]], "action: ")):
            with self.assertRaisesRegex(robostress.InvalidArgument, message):
                env.step(action)
        for state in (3.7, "x", [1]):
            with self.assertRaisesRegex(robostress.InvalidArgument, "initial_state is .*, must be a whole number"):
                env.reset(options={"initial_state": state})
        with self.assertRaisesRegex(robostress.InvalidArgument, "initial state 50 does not exist"):
            env.reset(options={"initial_state": 50})
        env.step(numpy.zeros(7))
        env.close()
        env.close()
        with self.assertRaisesRegex(robostress.RobostressError, "closed|call reset"):
            env.step(numpy.zeros(7))

    def test_belongs_to_the_process_that_made_it(self):
        env = self.make(views=False)
        env.reset(options={"initial_state": 0})
        for copied in (copy.copy, copy.deepcopy, pickle.dumps):
            with self.assertRaisesRegex(TypeError, "SuiteEnv cannot be copied or pickled: make another"):
                copied(env.unwrapped)
        child = os.fork()
        if child == 0:
            try:
                env.step(numpy.zeros(7))
            except robostress.WrongOrder as fault:
                env.unwrapped.close()
                os._exit(0 if "make another here" in str(fault) else 1)
            os._exit(2)
        self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 0)
        env.step(numpy.zeros(7))
        # A terminal's Ctrl-C goes to the group of the process that it runs.
        self.assertNotEqual(os.getpgid(env.unwrapped._process.pid), os.getpgid(0))

    def test_a_program_that_dies_is_an_error(self):
        env = self.make(views=False)
        env.reset(seed=3)
        env.unwrapped._process.kill()
        env.unwrapped._process.wait()
        with self.assertRaisesRegex(robostress.RobostressError, "ended with -9"):
            env.step(numpy.zeros(7))

    def test_an_interrupted_step_never_gets_the_answer_of_another(self):
        class Late(Exception):
            pass

        def late(*_):
            raise Late

        with tempfile.TemporaryDirectory() as folder:
            slow = pathlib.Path(folder, "robostress-environment")
            slow.write_text(SLOW_PROGRAM.format(python=sys.executable))
            slow.chmod(0o755)
            with unittest.mock.patch.dict(os.environ, ROBOSTRESS_BIN=folder):
                env = self.make(views=False)
            env.reset(seed=1)
            before = signal.signal(signal.SIGALRM, late)
            try:
                signal.setitimer(signal.ITIMER_REAL, 0.5)
                with self.assertRaises(Late):
                    env.step(numpy.zeros(7))
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
                signal.signal(signal.SIGALRM, before)
            for call in (lambda: env.step(numpy.zeros(7)), lambda: env.reset(seed=1)):
                with self.assertRaisesRegex(robostress.RobostressError, "closed: make another"):
                    call()

    def test_one_that_was_never_made_goes_quietly(self):
        with unittest.mock.patch.object(sys, "unraisablehook") as told:
            with self.assertRaises(robostress.InvalidArgument):
                robostress.gymnasium_suites.SuiteEnv(render_mode="human")
            gc.collect()
        told.assert_not_called()

    def test_without_the_program_it_says_what_to_install(self):
        before = os.environ["ROBOSTRESS_BIN"]
        os.environ["ROBOSTRESS_BIN"] = tempfile.gettempdir()
        try:
            with self.assertRaisesRegex(robostress.NotFound, "robostress-worker"):
                self.make()
        finally:
            os.environ["ROBOSTRESS_BIN"] = before


def steps_per_second(env, steps=100):
    env.reset(seed=1)
    began = time.perf_counter()
    for _ in range(steps):
        env.step(numpy.zeros(7, numpy.float32))
    return steps / (time.perf_counter() - began)


if __name__ == "__main__":
    if sys.argv[1:] == ["--rates"]:  # no test: what a process border costs
        for views in (False, True):
            print(f"views {views}: {steps_per_second(gymnasium.make(GOAL, views=views)):.1f} steps a second")
    else:
        unittest.main()
