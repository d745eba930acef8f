"""The table of success in LIBERO's tasks, against a policy server in this process, with the shared tree's assets."""
import argparse
import contextlib
import io
import json
import os
import pathlib
import sys
import tempfile
import threading
import unittest
import unittest.mock

import msgpack
import numpy
from websockets.sync.server import serve

import libero_parts
from robostress import Compensator, InvalidArgument, libero_success

SUITE = "libero_object"


class Server:
    """A policy that holds still, and keeps what it was asked."""

    def __init__(self):
        self.seen, self.greeting = [], {"policies": [{"name": "still", "model_hash": "5a"}], "server": "robostress"}
        self._server = serve(self._talk, "127.0.0.1", 0, compression=None, max_size=None)
        self.uri = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    def _talk(self, connection):
        connection.send(msgpack.packb(self.greeting))
        hold = numpy.tile(numpy.array([0, 0, 0, 0, 0, 0, -1], "<f4"), (10, 1))
        for frame in connection:
            self.seen.append(msgpack.unpackb(frame))
            connection.send(msgpack.packb({"actions": {b"__ndarray__": True, b"data": hold.tobytes(), b"dtype": "<f4",
                                                       b"shape": hold.shape}}))

    def close(self):
        self._server.shutdown()
        self._thread.join()


def image(packed):
    return numpy.frombuffer(packed[b"data"], packed[b"dtype"]).reshape(packed[b"shape"])


class Success(unittest.TestCase):
    def setUp(self):
        self.server = Server()
        self.addCleanup(self.server.close)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = pathlib.Path(folder.name, "outcomes.jsonl")

    def run_with(self, *arguments):
        """Exit code, table, messages."""
        table, messages = io.StringIO(), io.StringIO()
        with unittest.mock.patch.object(sys, "argv", ["libero_success", self.server.uri, "--suite", SUITE, *arguments]), \
                unittest.mock.patch.dict(libero_success.STEPS, {SUITE: 6}), \
                contextlib.redirect_stdout(table), contextlib.redirect_stderr(messages):
            code = libero_success.main()
        return code, table.getvalue(), messages.getvalue()

    def test_a_table_whose_episodes_are_kept_and_not_played_again(self):
        few = ("--tasks", "0", "--scenarios", "clean,heavy_payload", "--methods", "base,ours_following_smooth/2",
               "--episodes", "1", "--image-size", "32", "--out", str(self.out))
        code, table, messages = self.run_with(*few)
        self.assertEqual(code, 0, messages)
        self.assertEqual(table.splitlines()[2:], ["| clean | 1 | 0 | 0 |", "| heavy_payload | 1 | 0 | 0 |"])
        rows = [json.loads(line) for line in self.out.read_text().splitlines()]
        self.assertEqual([(row["scenario"], row["method"], row["rows"], row["steps"]) for row in rows],
                         [("clean", "base", 5, 6), ("clean", "ours_following_smooth/2", 2, 6),
                          ("heavy_payload", "base", 5, 6), ("heavy_payload", "ours_following_smooth/2", 2, 6)])
        self.assertEqual(rows[0]["policy"], "5a")
        asked = self.server.seen
        self.assertEqual(len(asked), 2 * (2 + 3), "a chunk of 5 and one of 1; three of 2")
        self.assertEqual([message.get("reset", False) for message in asked], [True, False, True, False, False] * 2)
        self.assertEqual(asked[0]["prompt"], "pick up the alphabet soup and place it in the basket")
        self.assertEqual(asked[0]["session"], {"resize": True, "method": "base", "method_options": []})
        self.assertEqual(image(asked[0]["observation/image"]).shape, (32, 32, 3))
        # At rest above the floor: position, a hand that looks down, open fingers.
        state = image(asked[0]["observation/state"])
        self.assertEqual(state.shape, (8,))
        self.assertTrue(0.2 < state[2] < 0.3 and abs(abs(state[3]) - numpy.pi) < 0.1 and state[6] > 0.03, state)

        code, again, messages = self.run_with(*few)
        self.assertEqual((code, again), (0, table))
        self.assertIn("4 of 4 episodes are from", messages)
        self.assertEqual(len(asked), 10)
        self.run_with(*few, "--rows", "3")
        self.assertEqual(len(asked), 10 + 2 * 2, "base alone has other rows")

    def test_views_are_turned_and_orientations_are_axis_angles(self):
        view = numpy.arange(12, dtype=numpy.uint8).reshape(2, 2, 3)
        half = numpy.sin(numpy.pi / 6)
        seen = {"agentview_image": view, "robot0_eye_in_hand_image": view + 12, "robot0_eef_pos": [1, 2, 3],
                "robot0_eef_quat": [0, half, 0, numpy.cos(numpy.pi / 6)], "robot0_gripper_qpos": [4, -4]}
        client = unittest.mock.Mock(infer=unittest.mock.Mock(return_value={"actions": numpy.zeros((3, 32))}))
        self.assertEqual(libero_success._Robot(client, "open it", True).chunk(seen, 2, (4, 2)).shape, (2, 7))
        (asked,), more = client.infer.call_args
        self.assertEqual((more, asked["episode"]), ({"reset": True}, {"task": 4, "episode": 2}))
        numpy.testing.assert_array_equal(asked["observation/image"], [[[9, 10, 11], [6, 7, 8]], [[3, 4, 5], [0, 1, 2]]])
        numpy.testing.assert_array_equal(asked["observation/wrist_image"], asked["observation/image"] + 12)
        numpy.testing.assert_allclose(asked["observation/state"], [1, 2, 3, 0, numpy.pi / 3, 0, 4, -4], rtol=1e-6)

    def test_every_episode_begins_among_the_same_fixtures_and_learns_by_its_chunks(self):
        env, robot = unittest.mock.MagicMock(), unittest.mock.Mock()
        env.step.return_value = ({}, 0, True, {})
        robot.chunk.return_value = numpy.zeros((3, 7), numpy.float32)
        robot.tool.return_value = ([0, 0, 1], [1, 0, 0, 0])
        made = []
        with unittest.mock.patch.object(libero_success, "Compensator",
                                        side_effect=lambda *given, **more: made.append(Compensator(*given, **more)) or made[-1]):
            libero_success._play(env, robot, "direct", 3, "state", 6, (0, 0))
        self.assertEqual(env.mock_calls[:3], [unittest.mock.call.seed(7), unittest.mock.call.reset(),
                                              unittest.mock.call.set_init_state("state")])
        self.assertEqual(made[-1]._rows, 3)

    def test_tasks(self):
        self.assertEqual(libero_success._numbers("0,3-5"), [0, 3, 4, 5])
        self.assertIsNone(libero_success._numbers("all"))
        for text in ("5-2", "two", "1-", "-1", ""):
            with self.assertRaises(argparse.ArgumentTypeError, msg=text):
                libero_success._numbers(text)

    def test_what_a_server_may_say_instead_of_actions(self):
        for reply, message in (({}, "KeyError 'actions'"), ([1], "TypeError"), ({"actions": "go"}, "ValueError"),
                               ({"actions": numpy.zeros(7)}, r"shape \[7\], must be \[5 or more, 7 or more\]"),
                               ({"actions": numpy.zeros((4, 7))}, r"shape \[4, 7\]"),
                               ({"actions": numpy.zeros((5, 6))}, r"shape \[5, 6\]")):
            with self.assertRaisesRegex(InvalidArgument, message):
                libero_success._actions(reply, 5)
        self.assertEqual(libero_success._actions({"actions": numpy.zeros((50, 32))}, 5).shape, (5, 7))

    def test_a_cut_off_line_and_an_unnamed_policy(self):
        few = ("--tasks", "0", "--scenarios", "clean", "--methods", "base", "--episodes", "1", "--image-size", "32",
               "--out", str(self.out))
        self.run_with(*few)
        whole = self.out.read_text()
        self.out.write_text(whole + whole[:20])
        code, table, messages = self.run_with(*few)
        self.assertEqual((code, self.out.read_text()), (0, whole), messages)
        self.assertIn("the last line was cut off", messages)
        self.assertIn("1 of 1 episodes are from", messages)
        self.server.greeting = {}
        code, _, messages = self.run_with(*few)
        self.assertEqual(code, 1)
        self.assertIn("--out needs --policy-name", messages)

    def test_what_cannot_be_is_named(self):
        self.out.write_text('{"suite": "other"}\n')
        for arguments, message in (
                (("--tasks", "10"), "--tasks 10: libero_object has tasks 0 to 9"),
                (("--tasks", "0", "--first-state", "45"), "--episodes 10 from --first-state 45: task 0 .* states 0 to 49"),
                (("--scenarios", "heavy_paylod"), "heavy_paylod is not one of clean"),
                (("--methods", "ours_folowing"), "ours_folowing"),
                (("--methods", "base/two"), "--methods base/two: .* base/2"),
                (("--methods", "base,base/5"), "--methods: .*'base', 5.* is given twice"),
                (("--tasks", "0-1,1"), "--tasks: 1 is given twice"),
                (("--methods", "base/²"), "behind the slash"),
                (("--out", "/nowhere/outcomes.jsonl"), "No such file or directory: '/nowhere/outcomes.jsonl'"),
                (("--episodes", "0"), "--episodes is 0, must be 1 or more"),
                (("--suite", "libero_goals"), "suite 'libero_goals' is not one of this LIBERO's: .*libero_goal"),
                (("--out", str(self.out)), "outcomes.jsonl:1 is no outcome of this program")):
            code, table, messages = self.run_with(*arguments)
            self.assertEqual((code, table), (1, ""), arguments)
            self.assertRegex(messages, message)
        self.assertEqual(self.server.seen, [])
        for address in ("ws://127.0.0.1:9", "127.0.0.1:9"):
            with unittest.mock.patch.object(self.server, "uri", address):
                code, _, messages = self.run_with("--tasks", "0", "--episodes", "1")
            self.assertEqual(code, 1)
            self.assertIn(address, messages)


if __name__ == "__main__":
    if not libero_parts.TREE.is_dir():
        print(f"SKIPPED: no {libero_parts.TREE}")
        sys.exit(77)
    os.environ.setdefault("MUJOCO_GL", "egl")
    kept = libero_parts.prepare()
    pathlib.Path(kept.name, "config.yaml").write_text(
        f"bddl_files: {libero_parts.TREE / 'bddl_files'}\ninit_states: {libero_parts.TREE / 'init_files'}\nassets: unused\n")
    unittest.main()
