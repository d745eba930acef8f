"""The suites in vla-eval: its orchestrator, a model server of its own, our benchmark between them."""
import asyncio
import inspect
import json
import socket
import tempfile
import threading
import unittest

import guide_blocks
import numpy
import yaml
from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark
from vla_eval.model_servers.predict import PredictModelServer
from vla_eval.model_servers.serve import serve_async
from vla_eval.orchestrator import Orchestrator
from vla_eval.registry import resolve_import_string

import robostress
from robostress.gymnasium_suites import SuiteEnv
from robostress.vla_eval_benchmarks import LiberoBenchmark, SuiteBenchmark

NAME = "robostress.vla_eval_benchmarks:SuiteBenchmark"
DOWN = [0.1, 0, -1, 0, 0, 0, -0.3]


class Constant(PredictModelServer):
    """Says the same of everything, and keeps what it saw."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def predict(self, obs, ctx):
        self.seen.append(obs)
        return {"actions": numpy.array(DOWN, numpy.float32)}

    def get_observation_params(self):
        return {"send_state": True}


def served(server):
    """The address of `server`, in a thread that ends with the process."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    threading.Thread(target=lambda: asyncio.run(serve_async(server, host="127.0.0.1", port=port)), daemon=True).start()
    return f"ws://127.0.0.1:{port}"


def played(benchmark, actions, task=0, episode=3):
    """Where the arm was, of an episode with `actions`."""
    task = {"task_id": task, "episode_idx": episode, "name": "any"}

    async def play():
        await benchmark.start_episode(task)
        states = []
        for action in actions:
            await benchmark.apply_action({"actions": action})
            states.append(benchmark._last_result.info["measured"]["position"])
        return numpy.array(states), await benchmark.get_result()

    return asyncio.run(play())


class Suites(unittest.TestCase):
    def made(self, **arguments):
        benchmark = SuiteBenchmark(**{"image_size": 16, **arguments})
        self.addCleanup(benchmark.cleanup)
        return benchmark

    def test_the_harness_evaluates_a_model_server_on_a_suite(self):
        server = Constant()
        with tempfile.TemporaryDirectory() as folder:
            config = {"server": {"url": served(server)}, "output_dir": folder, "render": "cpu", "benchmarks": [
                {"benchmark": NAME, "episodes_per_task": 2, "max_tasks": 2, "max_steps": 5,
                 "params": {"suite": "tabletop_object", "scenario": "heavy_payload", "image_size": 16,
                            "send_wrist_image": True, "compensation": "ours_following", "compensation_rows": 2}}]}
            result, = asyncio.run(Orchestrator(config).run())
        self.assertEqual(len(result["tasks"]), 2, json.dumps(result, default=str)[:2000])
        for task in result["tasks"]:
            self.assertEqual([episode["metrics"]["success"] for episode in task["episodes"]], [False, False], task)
            self.assertNotIn("failure_reason", task["episodes"][0], task)
        self.assertEqual(len(server.seen), 2 * 2 * 5)
        self.assertEqual(server.seen[0]["images"]["wrist"].shape, (16, 16, 3))
        self.assertEqual(numpy.shape(server.seen[0]["states"]), (8,))
        self.assertNotEqual(server.seen[0]["task_description"], server.seen[-1]["task_description"])

    def test_an_episode_is_the_environments(self):
        actions = [DOWN] * 8
        mine, result = played(self.made(scenario="aged_transmission"), actions)
        env = SuiteEnv(scenario="aged_transmission", views=False)
        self.addCleanup(env.close)
        env.reset(options={"initial_state": 3})
        for row, position in enumerate(mine):
            sent = numpy.append(DOWN[:6], -1)  # a gripper opens or closes
            numpy.testing.assert_array_equal(env.step(sent)[-1]["measured"]["position"], position, str(row))
        self.assertEqual(result, {"success": False})

    def test_a_compensator_learns_from_every_chunk_of_rows(self):
        actions = numpy.tile(numpy.float32([0.4, 0, -0.2, 0, 0, 0, -1]), (30, 1))
        mine, _ = played(self.made(scenario="heavy_payload", compensation="ours_following", compensation_rows=5), actions)
        compensator, env = robostress.ModelFollowing(), SuiteEnv(scenario="heavy_payload", views=False)
        self.addCleanup(env.close)
        compensator.start_episode()
        _, info = env.reset(options={"initial_state": 3})
        for chunk in range(6):
            states = [info["measured"]]
            for row in compensator.correct(actions[5 * chunk:5 * chunk + 5]):
                _, _, _, _, info = env.step(row)
                states.append(info["measured"])
                numpy.testing.assert_array_equal(info["measured"]["position"], mine[5 * chunk + len(states) - 2])
            compensator.executed([s["position"] for s in states], [s["quaternion"] for s in states])
        self.assertGreater(numpy.abs(compensator.correction).max(), 0)

    def test_ten_tasks_have_their_own_sentences(self):
        tasks = self.made().get_tasks()
        self.assertEqual(len({task["name"] for task in tasks}), 10)
        self.assertEqual([task["task_id"] for task in tasks], list(range(10)))

    def test_bad_arguments_say_what_is_wrong(self):
        with self.assertRaisesRegex(robostress.RobostressError, "no_such"):
            self.made(scenario="no_such").get_tasks()
        with self.assertRaisesRegex(robostress.RobostressError, "rows is 0, must be 1 to 1024"):
            self.made(compensation="gain", compensation_rows=0)
        with self.assertRaisesRegex(robostress.RobostressError, "nonsense"):
            self.made(compensation="nonsense")
        for bad in ([0] * 6, [float("nan")] * 7, [[0] * 7, [0] * 7]):
            with self.assertRaisesRegex(robostress.RobostressError, "7 finite numbers"):
                played(self.made(), [bad])

    def test_an_environment_that_died_is_made_again(self):
        benchmark = self.made()
        played(benchmark, [DOWN])
        benchmark._env._process.kill()
        benchmark._env._process.wait()
        played(benchmark, [DOWN])

    def test_targets_are_not_corrected_as_displacements(self):
        with self.assertRaisesRegex(robostress.InvalidArgument, "absolute_action sends targets"):
            LiberoBenchmark(suite="libero_goal", absolute_action=True, compensation="ours_following")

    def test_the_guides_configuration_is_one(self):
        entries = yaml.safe_load(guide_blocks.examples("In vla-eval and LeRobot", "yaml")[0])["benchmarks"]
        for entry in entries:
            made = resolve_import_string(entry["benchmark"])(**entry["params"])
            self.assertEqual(made.get_metadata()["scenario"], entry["params"]["scenario"])

    def test_a_late_action_moves_nothing(self):
        hold = self.made().get_hold_action
        numpy.testing.assert_array_equal(hold(None)["actions"], [0, 0, 0, 0, 0, 0, -1])
        numpy.testing.assert_array_equal(hold({"actions": [1] * 7})["actions"], [0, 0, 0, 0, 0, 0, 1])

    def test_a_model_server_may_set_liberos_own_parameters(self):
        known = inspect.signature(LiberoBenchmark.__init__).parameters
        self.assertGreater(set(known), set(inspect.signature(LIBEROBenchmark.__init__).parameters))
        self.assertIn("scenario", known)


if __name__ == "__main__":
    unittest.main()
