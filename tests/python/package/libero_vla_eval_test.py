"""vla-eval's LIBERO benchmark beside ours, on one of LIBERO's tasks with the shared tree's assets."""
import asyncio
import json
import os
import pathlib
import sys
import tempfile
import types
import unittest

import numpy

import guide_blocks
import libero_parts

TASKS = ("libero_object_00", "libero_object_01")
SUITE = "libero_object"


class Suite:
    """As LIBERO's own, which needs Torch to read its initial states."""

    n_tasks = len(TASKS)

    def get_task(self, index):
        name, _ = libero_parts.recorded(TASKS[index])
        return types.SimpleNamespace(language=name.replace("_", " "), problem_folder=SUITE, bddl_file=f"{name}.bddl")

    def get_task_init_states(self, index):
        return libero_parts.initial_states(SUITE, libero_parts.recorded(TASKS[index])[0])


class Libero(unittest.TestCase):
    def made(self, kind, **arguments):
        benchmark = kind(suite=SUITE, num_steps_wait=2, send_wrist_image=True, send_state=True, **arguments)
        benchmark._task_suite = Suite()
        self.addCleanup(benchmark.cleanup)
        return benchmark

    def played(self, benchmark, task=0, steps=6):
        """Joints after each step, and the last result."""
        _, rows = libero_parts.recorded(TASKS[task])

        async def play():
            await benchmark.start_episode({**benchmark.get_tasks()[task], "episode_idx": 1})
            joints = []
            for row in rows[:steps]:
                await benchmark.apply_action({"actions": numpy.clip(row, -1, 1)})
                joints.append(numpy.array(benchmark._env.sim.data.qpos[:7]))
            return numpy.array(joints), await benchmark.get_observation()

        return asyncio.run(play())

    def test_clean_is_liberos_own(self):
        plain, seen = self.played(self.made(LIBEROBenchmark))
        clean, seen_too = self.played(self.made(LiberoBenchmark))
        numpy.testing.assert_array_equal(plain, clean)
        numpy.testing.assert_array_equal(seen["images"]["wrist"], seen_too["images"]["wrist"])
        numpy.testing.assert_array_equal(seen["states"], seen_too["states"])

    def test_errors_act_after_the_settling_and_in_every_task(self):
        from libero.libero import envs
        original = envs.OffScreenRenderEnv
        benchmark = self.made(LiberoBenchmark, scenario="aged_transmission", severity=5)
        self.assertEqual(benchmark.get_metadata()["scenario"], "aged_transmission")
        clean = self.made(LiberoBenchmark)
        for task in range(2):
            worn, _ = self.played(benchmark, task)
            self.assertGreater(numpy.abs(worn - self.played(clean, task)[0]).max(), 1e-4)
            self.assertEqual(benchmark._last_result.info["robostress"]["applied"].shape, (25, 7))
            again, _ = self.played(benchmark, task)
            numpy.testing.assert_allclose(worn, again, atol=1e-12, err_msg="an episode begins anew")
        self.assertIs(envs.OffScreenRenderEnv, original)
        self.assertTrue(hasattr(benchmark._env.env, "_check_success"), "what is inside LIBERO's environment, not that itself")

    def test_a_compensator_corrects_what_the_model_server_says(self):
        base, _ = self.played(self.made(LiberoBenchmark, scenario="heavy_payload"), steps=24)
        mine, _ = self.played(self.made(LiberoBenchmark, scenario="heavy_payload", compensation="gain", compensation_rows=4),
                              steps=24)
        self.assertGreater(numpy.abs(base - mine).max(), 1e-3)


    def test_the_guides_examples_run(self):
        name, rows = libero_parts.recorded(TASKS[0])
        here = {"bddl_file": str(libero_parts.TREE / "bddl_files" / SUITE / f"{name}.bddl"), "horizon": 8,
                "initial_state": libero_parts.initial_states(SUITE, name)[0],
                "policy": lambda observation: rows[:4] * (observation["robot0_eef_pos"][2] > 0)}
        here["eight_numbers_of_your_policy"] = lambda observation: numpy.zeros(8)
        with tempfile.TemporaryDirectory() as folder:
            for heading in ("Stress a LIBERO policy", "Compensate it", "Record it for training"):
                example, = guide_blocks.examples(heading)
                exec(example.replace('"data/worn"', repr(folder + "/worn")), here)
            info = json.loads(pathlib.Path(folder, "worn/meta/info.json").read_text())
        self.assertEqual((info["total_episodes"], info["total_frames"]), (1, 8))
        self.assertEqual(info["features"]["observation.images.image2"]["shape"], [128, 128, 3])
        self.assertEqual(here["info"]["robostress"]["applied"].shape, (25, 7))
        self.assertEqual(here["following"].correction.shape, (6,))
        here["env"].close()


if __name__ == "__main__":
    if not libero_parts.TREE.is_dir():
        print(f"SKIPPED: no {libero_parts.TREE}")
        sys.exit(77)
    os.environ.setdefault("MUJOCO_GL", "egl")
    kept = libero_parts.prepare()
    pathlib.Path(kept.name, "config.yaml").write_text(f"bddl_files: {libero_parts.TREE / 'bddl_files'}\nassets: unused\n")
    from vla_eval.benchmarks.libero.benchmark import LIBEROBenchmark
    from robostress.vla_eval_benchmarks import LiberoBenchmark
    unittest.main()
