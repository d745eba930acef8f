"""Episodes of Python environments as data sets, read back with the libraries that LeRobot reads with."""
import ctypes
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import threading
import unittest
import unittest.mock

import numpy as np
import robostress as rs
from robostress._library import LIBRARY

READER = pathlib.Path(__file__).resolve().parents[2] / "common/lerobot/read_dataset.py"


def picture(i, height=24, width=32):
    return ((np.arange(height * width * 3).reshape(height, width, 3) // 7 + 40 * i) % 256).astype(np.uint8)


def fill(data, steps, seed=0):
    stream = rs.Stream("dataset test", seed)
    for i in range(steps):
        command = stream.normal(7)
        data.add(stream.normal(8), {"image": picture(i), "image2": picture(2 * i, 16, 16)}, commanded=command,
                 sent=command + 1, measured=command / 4)


class Datasets(unittest.TestCase):
    def setUp(self):
        scratch = tempfile.TemporaryDirectory()
        self.addCleanup(scratch.cleanup)
        self.folder = pathlib.Path(scratch.name) / "set"

    def read_back(self):
        done = subprocess.run([sys.executable, READER, self.folder], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, env={**os.environ, "HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1"})
        self.assertEqual(done.returncode, 0, done.stdout)
        return done.stdout

    def test_lerobots_libraries_read_what_is_written(self):
        with rs.EpisodeDataset(self.folder) as data:
            fill(data, 12)
            self.assertEqual(data.end("open the drawer", True), 0)
        with rs.EpisodeDataset(self.folder) as data:
            fill(data, 5, 1)
            self.assertEqual(data.end("close the drawer", False), 1)
            fill(data, 3, 2)
            data.discard()
            self.assertEqual((data.episodes, data.steps), (2, 17))
        said = self.read_back()
        self.assertIn("episode 0: 'open the drawer' length 12 success True", said)
        self.assertIn("episode 1: 'close the drawer' length 5 success False", said)

    def test_a_forked_process_writes_into_no_set_of_its_parents(self):
        with rs.EpisodeDataset(self.folder) as data:
            fill(data, 3)
            child = os.fork()
            if child == 0:
                try:
                    data.end("the child's", True)
                except rs.WrongOrder as refused:
                    os._exit(7 if "one recorder a folder" in str(refused) else 1)
                os._exit(0)
            self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 7)
            self.assertEqual(data.end("the parent's", True), 0)
            self.assertEqual((data.episodes, data.steps), (1, 3))

    def test_commanded_sent_and_measured_are_columns_and_pictures_are_lossless(self):
        import datasets
        stream = rs.Stream("dataset test", 0)
        with rs.EpisodeDataset(self.folder, more={"temperature": 1, "torque": ["a", "b"]}, cameras=["image"]) as data:
            commands = [stream.normal(7) for _ in range(4)]
            for i, command in enumerate(commands):
                data.add(np.full(8, i), {"image": picture(i)}, commanded=command, sent=2 * command, measured=3 * command,
                         temperature=[20 + i], torque=[i, -i])
            data.end("x", True)
        rows = datasets.Dataset.from_parquet(str(self.folder / "data/chunk-000/file-000.parquet"),
                                             cache_dir=str(self.folder / "cache"))
        for name, factor in (("action", 1), ("action.sent", 2), ("action.measured", 3)):
            np.testing.assert_array_equal(np.array(rows[name], np.float32),
                                          np.array([factor * c for c in commands], np.float32), name)
        self.assertEqual(list(rows["temperature"]), [20, 21, 22, 23])
        self.assertEqual(list(rows["torque"]), [[0, 0], [1, -1], [2, -2], [3, -3]])
        pictures = rows.cast_column("observation.images.image", datasets.Image())["observation.images.image"]
        for i in range(4):
            np.testing.assert_array_equal(np.asarray(pictures[i]), picture(i))

    def test_measured_is_the_displacement_in_units_of_a_command(self):
        turn = np.array([np.cos(0.05), 0, 0, np.sin(0.05)])  # 0.1 rad about z
        values = rs.measured(([0.4, 0, 0.2], [1, 0, 0, 0]), ([0.41, -0.005, 0.2], turn), [9, 9, 9, 9, 9, 9, -1])
        np.testing.assert_allclose(values, [0.2, -0.1, 0, 0, 0, 0.2, -1], atol=1e-12)

    def test_what_is_wrong_is_said_and_leaves_the_set_as_it_was(self):
        data = rs.EpisodeDataset(self.folder, more={"torque": 2})
        good = {"state": np.zeros(8), "images": {"image": picture(0), "image2": picture(0)}, "commanded": np.zeros(7),
                "measured": np.zeros(7), "torque": [0, 0]}
        data.add(**good)
        for change, message in (
                ({"state": np.zeros(7)}, r"observation.state has shape \[7\], must be \[8\]"),
                ({"images": {"image": picture(0)}}, r"pictures of \['image'\] are given"),
                ({"images": {"image": picture(0, 8, 8), "image2": picture(0)}}, r"is \[8, 8, 3\], the episode's first was"),
                ({"images": {"image": picture(0) / 255, "image2": picture(0)}}, "is float64"),
                ({"commanded": "left"}, "action: .* must be numbers"),
                ({"wheel": [0]}, r"columns \['torque', 'wheel'\] are given, the set has \['torque'\]")):
            with self.assertRaisesRegex(rs.InvalidArgument, message):
                data.add(**{**good, **change})
        self.assertEqual(data.end("x", True), 0)
        with self.assertRaisesRegex(rs.WrongOrder, "no steps"):
            data.end("x", True)
        data.add(**good)
        for change, message in (
                ({"measured": np.full(7, np.nan)}, r"action.measured of step 1 is \[nan, .*must be finite"),
                ({"images": {"image": np.zeros((0, 32, 3), np.uint8), "image2": picture(0)}}, r"\[0, 32, 3\], must be .* 1 to")):
            with self.assertRaisesRegex(rs.InvalidArgument, message):
                data.add(**{**good, **change})
        data.discard()
        data.add(**{**good, "images": {"image": picture(0, 8, 8), "image2": picture(0)}})
        with self.assertRaisesRegex(rs.InvalidArgument, r"observation.images.image is \[24,32,3\]"):
            data.end("x", True)
        with self.assertRaisesRegex(rs.InvalidArgument, "instruction is None, must be text"):
            data.end(None, True)
        self.assertEqual((data.episodes, data.steps), (1, 1))
        data.close()
        data.close()
        with self.assertRaisesRegex(rs.WrongOrder, "closed"):
            data.add(**good)
        self.read_back()
        for options, message in (({"cameras": "image"}, r"cameras is 'image', must be a list of names: \['image'\]"),
                                 ({}, "info.json: feature torque is"), ({"fps": 10}, "fps is 20"), ({"fps": 2.5}, "whole number"),
                                 ({"robot": "ur5e"}, "robot_type"), ({"cameras": ["a/b"]}, "camera 'a/b'"),
                                 ({"more": {"next.done": 1}}, "feature next.done already"),
                                 ({"more": {"action": 1}}, "which is a column already"),
                                 ({"more": {"torque": 0}}, "column torque is 0, must be 1 to"),
                                 ({"fps": "20"}, "fps is '20', must be a number")):
            with self.assertRaisesRegex(rs.InvalidArgument, message):
                rs.EpisodeDataset(self.folder, **options)
        self.assertEqual(json.loads((self.folder / "meta/info.json").read_text())["total_episodes"], 1)

    def test_pictures_that_are_turned_or_mirrored_have_their_statistics(self):
        channels_first = np.stack([np.full((24, 32), 200 - 100 * c, np.uint8) for c in range(3)])
        channels_first[:, :, :8] //= 2
        for name, given in (("turned", channels_first.transpose(1, 2, 0)),
                            ("mirrored", channels_first.transpose(1, 2, 0)[:, ::-1])):
            with self.subTest(name), rs.EpisodeDataset(self.folder / name, cameras=["image"]) as data:
                for _ in range(3):
                    data.add(np.zeros(8), {"image": given}, commanded=np.zeros(7), measured=np.zeros(7))
                data.end("x", True)
                told = json.loads((self.folder / name / "meta/stats.json").read_text())["observation.images.image"]
                np.testing.assert_allclose(np.ravel(told["mean"]) * 255, given.mean(axis=(0, 1)), rtol=1e-6)

    def test_a_folder_has_one_recorder(self):
        with rs.EpisodeDataset(self.folder) as data:
            with self.assertRaisesRegex(rs.WrongOrder, f"{self.folder} open, and there is one recorder a folder"):
                rs.EpisodeDataset(self.folder)
            fill(data, 3)
            data.end("x", True)
        self.assertEqual(sorted(path.name for path in (self.folder / "meta").iterdir()),
                         [".lock", "episodes", "info.json", "stats.json", "tasks.parquet"])
        self.read_back()
        rs.EpisodeDataset(self.folder).close()

    def test_what_was_written_when_ctrl_c_came_is_not_written_again(self):
        append = LIBRARY.robostress_dataset_append

        def interrupted(*given):
            append(*given)
            raise KeyboardInterrupt

        with rs.EpisodeDataset(self.folder) as data:
            fill(data, 3)
            with unittest.mock.patch.object(LIBRARY, "robostress_dataset_append", interrupted):
                with self.assertRaises(KeyboardInterrupt):
                    data.end("x", True)
            with self.assertRaisesRegex(rs.WrongOrder, "no steps"):
                data.end("x", False)
            self.assertEqual((data.episodes, data.steps), (1, 3))
        self.read_back()

    def test_a_set_that_lost_an_episode_does_not_grow(self):
        with rs.EpisodeDataset(self.folder) as data:
            for _ in range(2):
                fill(data, 3)
                data.end("x", True)
        lost = self.folder / "data/chunk-000/file-000.parquet"
        lost.unlink()
        with self.assertRaisesRegex(rs.WrongOrder, f"{lost} is not there, though .*info.json counts 2 episodes; put it back"):
            rs.EpisodeDataset(self.folder)

    def test_data_of_others_stays(self):
        theirs = self.folder / "data/chunk-000/file-000.parquet"
        theirs.parent.mkdir(parents=True)
        theirs.write_text("all episodes")
        with self.assertRaisesRegex(rs.WrongOrder, "holds data without .*info.json; record into another folder"):
            rs.EpisodeDataset(self.folder)
        self.assertEqual(theirs.read_text(), "all episodes")

    def test_what_the_disk_refuses_is_no_fault_of_the_library(self):
        with self.assertRaisesRegex(rs.StorageError, "/dev/null/set") as caught:
            rs.EpisodeDataset("/dev/null/set")
        self.assertIsInstance(caught.exception, OSError)

    def test_other_threads_go_on_while_an_episode_is_written(self):
        entered, go_on = threading.Event(), threading.Event()
        append = LIBRARY.robostress_dataset_append
        self.assertFalse(append._flags_ & ctypes.PyDLL._func_flags_ & ~ctypes.CDLL._func_flags_, "it keeps the interpreter")

        def slow(*given):
            entered.set()
            go_on.wait(10)
            return append(*given)

        with rs.EpisodeDataset(self.folder) as data:
            fill(data, 3)
            with unittest.mock.patch.object(LIBRARY, "robostress_dataset_append", slow):
                writer = threading.Thread(target=data.end, args=("x", True))
                writer.start()
                entered.wait(10)
                closer = threading.Thread(target=data.close)
                closer.start()
                closer.join(0.2)
                self.assertTrue(closer.is_alive(), "close() waits for the episode")
                go_on.set()
                writer.join()
                closer.join()
        with rs.EpisodeDataset(self.folder) as data:
            self.assertEqual(data.episodes, 1)


if __name__ == "__main__":
    unittest.main(verbosity=2)
