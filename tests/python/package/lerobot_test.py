"""lerobot-eval on a suite and on LIBERO with joint errors, with a policy of LeRobot's own classes at toy size.

By hand, because LeRobot takes 5 GB: with ROBOSTRESS_LEROBOT_PYTHON, a Python 3.12 or newer that has lerobot 0.6 and, for
LIBERO, hf-libero, `ctest -R python_lerobot`.
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

os.environ.setdefault("HF_HUB_OFFLINE", "1")

import libero_parts
import numpy
from lerobot.envs.configs import EnvConfig
from lerobot.envs.factory import make_env
from lerobot.utils.import_utils import register_third_party_plugins

TOYS = pathlib.Path(__file__).parents[2] / "deploy/lerobot_toys.py"


class LeRobot(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        register_third_party_plugins()

    def test_the_plug_in_is_found_by_its_name(self):
        self.assertLessEqual({"robostress", "robostress_libero"}, set(EnvConfig.get_known_choices()))

    def made(self, **options):
        from robostress.lerobot_envs import RobostressEnv
        envs = make_env(RobostressEnv(image_size=64, **options), n_envs=2)
        for tasks in envs.values():
            for env in tasks.values():
                self.addCleanup(env.close)
        return envs

    def test_environments_begin_in_different_states_and_say_what_lerobot_asks(self):
        envs = self.made(task="tabletop_object", task_ids=[1, 4], scenario="heavy_payload")
        self.assertEqual({suite: sorted(tasks) for suite, tasks in envs.items()}, {"tabletop_object": [1, 4]})
        env = envs["tabletop_object"][4]
        self.assertEqual(len(set(env.get_attr("task_description"))), 1)
        self.assertGreater(env.get_attr("_max_episode_steps")[0], 50)
        first, info = env.reset(seed=[1, 2])
        self.assertEqual(info["initial_state"].tolist(), [0, 1])
        self.assertEqual(env.reset(seed=[1, 2])[1]["initial_state"].tolist(), [2, 3])
        self.assertEqual(first["pixels"]["image2"].shape, (2, 64, 64, 3))
        _, _, _, _, info = env.step(numpy.zeros((2, 7), numpy.float32))
        self.assertEqual(info["is_success"].tolist(), [False, False])

    def test_a_task_that_is_not_there_is_refused(self):
        with self.assertRaisesRegex(Exception, r"task_ids is \[10\], a suite has tasks 0 to 9"):
            self.made(task_ids=[10])

    def test_lerobot_eval_runs_a_policy_under_a_scenario(self):
        with tempfile.TemporaryDirectory() as folder:
            run = lambda *command: subprocess.run(command, cwd=folder, text=True, stdout=subprocess.PIPE,
                                                  stderr=subprocess.STDOUT)
            made = run(sys.executable, str(TOYS), "make", "act", "toy")
            self.assertEqual(made.returncode, 0, made.stdout)
            done = run(str(pathlib.Path(sys.executable).with_name("lerobot-eval")), "--policy.path=toy", "--policy.device=cpu",
                       "--env.type=robostress", "--env.task=tabletop_goal", "--env.task_ids=[3]",
                       "--env.scenario=aged_transmission", "--eval.n_episodes=2", "--eval.batch_size=2", "--output_dir=out")
            self.assertEqual(done.returncode, 0, done.stdout[-3000:])
            report = json.loads(pathlib.Path(folder, "out/eval_info.json").read_text())
        self.assertEqual(report["overall"]["n_episodes"], 2, report["overall"])
        self.assertEqual(report["overall"]["pc_success"], 0, "random weights")


@unittest.skipUnless(libero_parts.TREE.is_dir(), f"no {libero_parts.TREE}")
class Libero(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        os.environ.setdefault("MUJOCO_GL", "egl")
        try:
            cls.kept = libero_parts.prepare()
        except ImportError as fault:
            raise unittest.SkipTest(f"{fault.name} is not there: pip install 'lerobot[libero]'")
        pathlib.Path(cls.kept.name, "config.yaml").write_text("".join(f"{key}: {value}\n" for key, value in {
            "bddl_files": libero_parts.TREE / "bddl_files", "init_states": libero_parts.TREE / "init_files",
            "assets": "unused", "datasets": "unused", "benchmark_root": libero_parts.TREE}.items()))

    def played(self, config):
        env = make_env(config, n_envs=1)["libero_object"][0]
        self.addCleanup(env.close)
        env.reset(seed=[1])
        for k in range(8):
            seen, _, _, _, info = env.step(numpy.array([[0.3, 0, -0.5, 0, 0, 0, -1]], numpy.float32))
        self.assertEqual(env.render()[0].shape[-1], 3)
        return seen["robot_state"]["joints"]["pos"][0], info

    def test_liberos_arm_wears_and_stays_its_own_without(self):
        from lerobot.envs.configs import LiberoEnv
        from robostress.lerobot_envs import RobostressLiberoEnv
        options = {"task": "libero_object", "task_ids": [0], "observation_height": 64, "observation_width": 64}
        plain, _ = self.played(LiberoEnv(**options))
        clean, _ = self.played(RobostressLiberoEnv(**options))
        worn, info = self.played(RobostressLiberoEnv(scenario="aged_transmission", **options))
        numpy.testing.assert_array_equal(plain, clean)
        self.assertGreater(numpy.abs(worn - plain).max(), 1e-4)
        self.assertIn("robostress", info)
        self.assertEqual(info["is_success"].tolist(), [False])


if __name__ == "__main__":
    unittest.main()
