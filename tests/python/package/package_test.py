#!/usr/bin/env python3
"""The installed package: bits of the C++ kernels, refusals, the programs behind it. Arguments by environment:
KERNEL_REFERENCE, CALIBRATE, SERVE; a test without its program is skipped."""
import contextlib
import copy
import gc
import io
import os
import pathlib
import pickle
import subprocess
import sys
import tempfile
import threading
import time
import types
import unittest
import weakref

import guide_blocks
import numpy as np

import robostress as rs

SUB_STEPS, CHUNKS, ROWS = 75, 8, 5
METHODS = ("base", "gain", "direct", "ours_integral", "ours_following")


def program(name):
    path = os.environ.get(name, "")
    if not path or not pathlib.Path(path).exists():
        raise unittest.SkipTest(f"{name} is not built: '{path}'")
    return path


def drawn_arm(stream):
    arm = {name: scale * stream.normal(7) for name, scale in
           (("q", 1), ("dq", 0.3), ("gravity", 10), ("payload_gravity", 3), ("payload_inertia", 0.2))}
    return arm, 40 * stream.normal(7)


class Kernels(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.reference = np.frombuffer(subprocess.run([program("KERNEL_REFERENCE")], stdout=subprocess.PIPE,
                                                     check=True).stdout)
        cls.errors_size = len(rs.scenarios()) * SUB_STEPS * 14

    def test_joint_errors_have_the_bits_of_the_kernels(self):
        expected = self.reference[:self.errors_size].reshape(-1, SUB_STEPS, 2, 7)
        limits = {"torque_low": np.full(7, -60.0), "torque_high": np.full(7, 60.0)}
        for scenario, rows in zip(rs.scenarios(), expected):
            for bound in (False, True):
                stream = rs.Stream("package test", scenario.name)
                errors = rs.JointErrors(scenario.name)
                arm, _ = drawn_arm(stream)
                own = {name: values.copy() for name, values in arm.items()}
                if bound:
                    errors.bind(**own)
                    own["dq"][:] = 0  # at rest
                    errors.reset(**limits)
                else:
                    errors.reset(arm["q"], **limits, **{k: v for k, v in arm.items() if k not in ("q", "dq")})
                for i in range(SUB_STEPS):
                    if i % 25 == 0:
                        errors.begin_control_step(i // 25, i >= 25)
                    arm, asked = drawn_arm(stream)
                    if bound:
                        for name, values in arm.items():
                            own[name][:] = values
                        applied, change = errors.sub_step(asked)
                    elif i % 2:
                        applied, change = errors.sub_step(asked, **arm)
                    else:
                        applied, change = errors.torque(asked, **arm), errors.offset_change()
                    np.testing.assert_array_equal(applied, rows[i, 0], f"{scenario.name}, sub-step {i}")
                    np.testing.assert_array_equal(change, rows[i, 1], f"{scenario.name}, sub-step {i}")

    def test_compensators_have_the_bits_of_the_kernels(self):
        expected = self.reference[self.errors_size:].reshape(len(METHODS), CHUNKS, ROWS, 7)
        classes = {"gain": rs.GainControl, "direct": rs.DirectSubtraction, "ours_integral": rs.IntegralAction,
                   "ours_following": rs.ModelFollowing}
        for method, chunks in zip(METHODS, expected):
            stream = rs.Stream("package test", method)
            compensator = classes[method]() if method in classes else rs.Compensator(method)
            compensator.start_episode()
            for chunk in chunks:
                actions = (0.5 * stream.normal(ROWS * 7)).astype(np.float32).reshape(ROWS, 7)
                sent = compensator.correct(actions)
                np.testing.assert_array_equal(sent, chunk, method)
                position = 0.02 * stream.normal(3 * (ROWS + 1)).reshape(-1, 3)
                compensator.executed(position, np.tile([1.0, 0, 0, 0], (ROWS + 1, 1)))


class Errors(unittest.TestCase):
    def test_lists_scenarios(self):
        self.assertEqual(rs.scenarios()[0], ("clean", "Clean", False))
        self.assertEqual(sum(scenario.deployed for scenario in rs.scenarios()), 7)
        self.assertRegex(rs.__version__, r"^\d+\.\d+\.\d+$")

    def test_says_value_limit_and_remedy(self):
        cases = [
            (rs.NotFound, "known: clean, heavy_payload", lambda: rs.JointErrors("worn")),
            (rs.InvalidArgument, "outside 1 .mild. .. 5", lambda: rs.JointErrors("nominal", severity=9)),
            (rs.InvalidArgument, "give its own as options.nominal", lambda: rs.JointErrors("nominal", joints=6)),
            (rs.InvalidArgument, r"nominal has shape \[3\], must be \[6, 9\]",
             lambda: rs.JointErrors("nominal", joints=6, nominal=np.zeros(3))),
            (rs.WrongOrder, "robostress_errors_reset first", lambda: rs.JointErrors("clean").sub_step(
                np.zeros(7), q=np.zeros(7), dq=np.zeros(7))),
            (rs.InvalidArgument, r"gravity\[0\] is nan", lambda: rs.JointErrors("nominal").reset(np.zeros(7))),
            (rs.InvalidArgument, "q has shape .6., must be of shape .7.",
             lambda: rs.JointErrors("clean").reset(np.zeros(6))),
            (rs.InvalidArgument, "joints is 'seven', must be a whole number",
             lambda: rs.JointErrors("clean", joints="seven")),
            (rs.InvalidArgument, "severity is 4.5, must be", lambda: rs.JointErrors("clean", severity=4.5)),
            (rs.InvalidArgument, "severity is 4294967299, must be", lambda: rs.JointErrors("clean", severity=2**32 + 3)),
            (rs.InvalidArgument, "scenario is None, must be a name", lambda: rs.JointErrors(None)),
            (rs.InvalidArgument, "steps_done is 1.0, must be", lambda: rs.JointErrors("clean").begin_control_step(1.0)),
            (rs.InvalidArgument, "joint is 0.5, must be", lambda: rs.JointErrors("clean").add_effect(0.5, "backlash", [0.01])),
            (rs.InvalidArgument, "action_dim is 7.5, must be", lambda: rs.Compensator("base", action_dim=7.5)),
            (rs.InvalidArgument, "rows is 0, must be 1 to", lambda: rs.Compensator("direct", rows=0)),
            (rs.InvalidArgument, "'mass' is nothing that an arm has; known: q, dq",
             lambda: rs.JointErrors("clean").reset(np.zeros(7), mass=1)),
            (rs.InvalidArgument, "q must be a contiguous float64 array",
             lambda: rs.JointErrors("clean").bind(q=np.zeros(14)[::2])),
            (rs.NotFound, "unknown method 'following'", lambda: rs.Compensator("following")),
            (rs.InvalidArgument, "trains an adapter", lambda: rs.Compensator("ours")),
            (rs.InvalidArgument, r"following_gain is 99, must be 0\.\.10", lambda: rs.ModelFollowing(following_gain=99)),
            (rs.InvalidArgument, r"actions has shape \[7\], must be \['any', 7\]",
             lambda: rs.ModelFollowing().correct(np.zeros(7))),
            (rs.InvalidArgument, "give position", lambda: rs.ModelFollowing().executed()),
            (rs.InvalidArgument, "1 states are no motion", lambda: rs.ModelFollowing().executed(np.zeros((1, 3)))),
            (rs.WrongOrder, "all 0 rows of the chunk", lambda: rs.ModelFollowing().next()),
            (rs.InvalidArgument, "friction_law is None, must be text", lambda: rs.JointErrors("clean", friction_law=None)),
            (rs.InvalidArgument, "tanh_width is 'wide', must be a number", lambda: rs.JointErrors("clean", tanh_width="wide")),
            (rs.InvalidArgument, "step is 'a', must be a number", lambda: rs.JointErrors("clean").reset(np.zeros(7), step="a")),
            (rs.InvalidArgument, "q: complex numbers", lambda: rs.JointErrors("clean").reset(np.zeros(7) + 1j)),
            (rs.InvalidArgument, "gravity: .*too large|gravity: .*int too",
             lambda: rs.JointErrors("nominal").reset(np.zeros(7), gravity=[10**400] * 7)),
            (rs.InvalidArgument, "nominal: complex numbers",
             lambda: rs.JointErrors("nominal", joints=1, nominal=np.ones((1, 9)) * 1j)),
            (rs.InvalidArgument, "space is None, must be text", lambda: rs.Compensator("base", space=None)),
            (rs.InvalidArgument, "control_period is '1', must be a number", lambda: rs.Compensator("base", control_period="1")),
            (rs.InvalidArgument, "sent has shape .6., must be .7.", lambda: rs.measured(POSE, POSE, np.zeros(6))),
            (rs.InvalidArgument, "sent is .*nan.* must be finite", lambda: rs.measured(POSE, POSE, [0] * 6 + [np.nan])),
            (rs.InvalidArgument, "before is .* must be a position and a quaternion",
             lambda: rs.measured(np.zeros(7), POSE, np.zeros(7))),
            (rs.InvalidArgument, "after's quaternion has shape .3., must be .4.",
             lambda: rs.measured(POSE, (np.zeros(3), np.zeros(3)), np.zeros(7))),
            (rs.InvalidArgument, "n is 0, must be 1 to", lambda: rs.Stream("x").integers(0, 1)),
            (rs.InvalidArgument, "part 1.5 of the key", lambda: rs.Stream("x", 1.5)),
            (rs.InvalidArgument, "rig is 'rig.yaml', must be a map", lambda: rs.calibrate("rig.yaml", [], program="true")),
            (rs.InvalidArgument, r"logs.0. is ..t., .q_hinge.., must be a map with the arrays under 'columns'",
             lambda: rs.calibrate({}, [{"t": [0], "q_hinge": [0]}], program="true")),
            (rs.InvalidArgument, "rig or log has a complex", lambda: rs.calibrate({"rate_hz": 1j}, [], program="true")),
            (rs.NotFound, "install the package robostress-calibration",
             lambda: rs.calibrate({}, [], program="no-such-program")),
        ]
        for kind, words, call in cases:
            with self.assertRaisesRegex(kind, words):
                call()
            self.assertTrue(issubclass(kind, rs.RobostressError))

    def test_a_copy_goes_on_as_its_original(self):
        errors, stream = rs.JointErrors("aged_joint_uniform"), rs.Stream("copy")
        arm, asked = drawn_arm(stream)
        errors.reset(**{k: v for k, v in arm.items() if k != "dq"})
        errors.sub_step(asked, **arm)
        saved = errors.copy()
        after = [a.copy() for a in errors.sub_step(asked)]
        np.testing.assert_array_equal(saved.copy().sub_step(asked), after)
        self.assertFalse(np.array_equal(errors.sub_step(asked)[1], after[1]))
        errors.restore(saved)
        np.testing.assert_array_equal(errors.sub_step(asked), after)

    def test_an_array_that_is_set_is_bound(self):
        errors, q, rates = rs.JointErrors("clean", joints=1), np.zeros(1), np.zeros(1)
        errors.add_effect(0, "backlash", [0.01])
        errors.q, errors.dq = q, rates
        self.assertIs(errors.dq, rates)
        errors.reset()
        rates[:] = 0.5
        for _ in range(100):
            q += 0.002 * rates + errors.sub_step([1.0])[1]
        self.assertAlmostEqual(abs(errors.offset()[0]), 0.01)
        with self.assertRaisesRegex(rs.InvalidArgument, "dq must be a contiguous float64 array"):
            errors.dq = [0]
        with self.assertRaises(AttributeError):
            errors.ddq

    def test_effects_ask_for_what_they_read(self):
        errors = rs.JointErrors("clean", joints=2)
        self.assertEqual(errors.reads, {"q", "dq"})
        errors.add_effect(0, "cross_joint_coupling", [3.0], coupled=1)
        self.assertIn("ddq", errors.reads)
        arm = {"mass_matrix": np.eye(2), "other_torque": 0}
        with self.assertRaisesRegex(rs.InvalidArgument, "ddq.0. is nan"):
            errors.reset([0.1, 0.2], **arm)
        errors.reset([0.1, 0.2], ddq=0, **arm)
        self.assertEqual(errors.sub_step([1, 1])[0].shape, (2,))

    def test_what_is_of_another_shape_is_not_spread_over_the_arm(self):
        errors = rs.JointErrors("clean", joints=3)
        errors.reset(np.zeros(3), gravity=9.81)  # a number alone is that of every joint
        for wrong in ([5.0], [[5.0, 5, 5]], [[5.0]]):
            with self.assertRaisesRegex(rs.InvalidArgument, r"asked has shape .*, must be of shape .3."):
                errors.sub_step(wrong)
            with self.assertRaisesRegex(rs.InvalidArgument, "gravity has shape"):
                errors.sub_step([5, 5, 5], gravity=wrong)
        with self.assertRaisesRegex(rs.InvalidArgument, "mass_matrix has shape .3., must be of shape .3, 3."):
            errors.sub_step([5, 5, 5], mass_matrix=[1, 2, 3])

    def test_a_text_with_a_nul_is_not_cut_there(self):
        for make in (lambda: rs.JointErrors("clean\0heavy_payload"), lambda: rs.Compensator("base\0"),
                     lambda: rs.JointErrors("clean", friction_law="sgn\0stick"), lambda: rs.Compensator("gain", gain="1.5\0x"),
                     lambda: rs.EpisodeDataset("set\0junk"),
                     lambda: rs.Stream("a\0b"), lambda: rs.Stream("a", "b\0c")):
            with self.assertRaisesRegex(rs.InvalidArgument, "there is a NUL in it"):
                make()

    def test_nothing_is_written_into_what_was_bound(self):
        errors, q, dq = rs.JointErrors("clean", joints=2), np.ones(2), np.zeros(2)
        errors.bind(q=q, dq=dq)
        for call in (lambda: errors.reset([0, 0]), lambda: errors.sub_step([1, 1], q=[0, 0])):
            with self.assertRaisesRegex(rs.InvalidArgument, "q: your own arrays are bound and read"):
                call()
        errors.reset()
        errors.sub_step([1, 1])
        np.testing.assert_array_equal(q, [1, 1])
        errors.copy().reset([0, 0])  # a copy has arrays of its own

    def test_readings_and_offsets(self):
        errors = rs.JointErrors("clean", joints=1)
        errors.add_effect(0, "backlash", [0.01])
        q = np.zeros(1)
        errors.reset(q)
        for _ in range(100):
            q += 0.002 * 0.5 + errors.sub_step([1.0], q=q, dq=0.5)[1]
        self.assertAlmostEqual(abs(errors.offset()[0]), 0.01)
        np.testing.assert_array_equal(errors.reading([0.3], [0.1]), [[0.3], [0.1]])

    def attached(self):
        """Errors without an effect at two joints of a simulator, its qpos and ctrl."""
        simulator = {"qpos": np.zeros(2), "qvel": np.zeros(2), "ctrl": np.zeros(2), "xaxis": np.tile([0, 1.0, 0], (2, 1)),
                     "xanchor": np.zeros((2, 3)), "subtree_com": np.full((2, 3), 0.1), "subtree_mass": np.ones(2)}
        errors = rs.JointErrors("clean", joints=2)
        errors.attach([0, 0, -9.81], rows=2, **simulator, **{name: [0, 1] for name in (
            "qpos_index", "dof_index", "ctrl_index", "joint_index", "body_index")})
        errors.reset_attached(0.002)
        return errors, simulator["qpos"], simulator["ctrl"]

    def test_acts_in_a_simulators_arrays(self):
        simulator = {"qpos": np.zeros(3), "qvel": np.zeros(3), "ctrl": np.zeros(3), "xaxis": np.tile([0, 1.0, 0], (3, 1)),
                     "xanchor": np.zeros((3, 3)), "subtree_com": np.full((3, 3), 0.1), "subtree_mass": np.ones(3)}
        indices = {name: [2, 0] for name in ("qpos_index", "dof_index", "ctrl_index", "joint_index", "body_index")}
        errors = rs.JointErrors("clean", joints=2)
        errors.add_effect(1, "backlash", [0.01])
        with self.assertRaisesRegex(rs.WrongOrder, "no arrays are attached"):
            errors.act([3, 4])
        errors.attach([0, 0, -9.81], rows=2, **simulator, **indices)
        errors.reset_attached(0.002)
        errors.act([3, 4])
        np.testing.assert_array_equal(simulator["ctrl"], [4, 0, 3])
        simulator["qvel"][0] = 1
        controller = type("Controller", (), {"torques": np.array([5.0, 6])})
        errors.actor(controller)()
        self.assertNotEqual(simulator["qpos"][0], 0)
        np.testing.assert_array_equal(errors.record, [[[3, 4], [3, 4]], [[5, 6], [5, 6]]])
        controller.torques = [7, 8]  # no array of floats
        errors.begin_control_step(1)
        errors.actor(controller)()
        np.testing.assert_array_equal(errors.record[0], [[7, 8], [7, 8]])
        controller.torques = [7, 8, 9]
        with self.assertRaisesRegex(rs.InvalidArgument, "asked has shape .3., must be of shape .2."):
            errors.actor(controller)()
        with self.assertRaisesRegex(rs.InvalidArgument, "ctrl must be the simulator's own"):
            errors.attach([0, 0, -9.81], **{**simulator, "ctrl": np.zeros(6)[::2]}, **indices)
        for wrong, words in (({"ctrl_index": [10**6, 0]}, "ctrl_index has 1000000, must be 0 to 2: ctrl has 3 rows"),
                             ({"dof_index": [-1, 0]}, "dof_index has -1, must be 0 to 2"),
                             ({"qpos": np.zeros(2)}, "qpos_index has 2, must be 0 to 1"),
                             ({"xanchor": np.zeros((2, 3))}, "joint_index has 2, must be 0 to 1: xanchor has 2 rows"),
                             ({"subtree_com": np.zeros(9)}, r"subtree_com must be .* array \[any, 3\]"),
                             ({"qpos_index": [0.9, 1.9]}, "must be 2 whole numbers"),
                             ({"tool": np.zeros(2)}, "tool has 2 entries"), ({"wheel": np.zeros(2)}, "arrays .*wheel.* must be")):
            with self.assertRaisesRegex(rs.InvalidArgument, words):
                errors.attach([0, 0, -9.81], **{**simulator, **indices, **wrong})

    def test_a_sub_step_is_a_built_in_function_of_cpython(self):
        errors, q, ctrl = self.attached()
        controller = types.SimpleNamespace(torques=np.array([1.0, 2]))
        step = errors.sub_step_of(controller, lambda: "physics")
        if sys.implementation.name == "cpython":
            self.assertEqual(type(step), type(len))
        self.assertEqual([step(), step(True)], 2 * ["physics"])
        np.testing.assert_array_equal(ctrl, [1, 2])
        references = sys.getrefcount(controller.torques)
        step()
        self.assertEqual(sys.getrefcount(controller.torques), references)
        for torques, applied in (([3, 4], [3, 4]), (np.array([5, 6]), [5, 6]), (np.array([7, 8], np.float32), [7, 8]),
                                 (np.array([9.0, 0, 8, 0])[::2], [9, 8]), (np.array([3.0, 4]).astype(">f8"), [3, 4])):
            controller.torques = torques
            self.assertEqual(step(), "physics")
            np.testing.assert_array_equal(ctrl, applied)
        for torques, words in ((np.ones(3), "asked has shape .3."), (np.ones((2, 1)), "asked has shape .2, 1."),
                               (None, "asked"), ("no", "asked"), (np.array([np.nan, 1]), "asked.0. is nan")):
            controller.torques = torques
            with self.assertRaisesRegex(rs.InvalidArgument, words):
                step()
        np.testing.assert_array_equal(ctrl, [3, 4])
        del controller.torques
        with self.assertRaisesRegex(AttributeError, "torques"):
            step()
        controller.torques = np.array([1.0, 2])

        def broken():
            raise ZeroDivisionError("in the physics")
        with self.assertRaisesRegex(ZeroDivisionError, "in the physics"):
            errors.sub_step_of(controller, broken)()

        class ReadOnce:
            reads = 0

            @property
            def torques(self):
                self.reads += 1
                return [self.reads, 0.0]
        once = ReadOnce()
        errors.sub_step_of(once, lambda: None)()
        np.testing.assert_array_equal(ctrl, [1, 0])
        # It keeps all that it needs, and gives it back.
        kept, alive = [step], weakref.ref(errors)
        del errors, step
        gc.collect()
        self.assertEqual(kept[0](), "physics")
        kept.clear()
        gc.collect()
        self.assertIsNone(alive())

    def test_seeds_give_streams_and_change_no_error(self):
        first, second = rs.JointErrors("clean", seed=1), rs.JointErrors("clean", seed=2)
        self.assertFalse(np.array_equal(first.stream("camera").normal(4), second.stream("camera").normal(4)))
        np.testing.assert_array_equal(first.stream("camera").normal(4), rs.Stream("camera", 1).normal(4))


class Compensators(unittest.TestCase):
    def motion(self, rows):
        position = np.cumsum(np.full((rows + 1, 3), 0.004), axis=0)
        return position, np.tile([1.0, 0, 0, 0], (rows + 1, 1))

    def test_residual_is_achieved_minus_commanded(self):
        base = rs.Compensator("base")
        sent = np.full((ROWS, 7), 0.25, np.float32)
        residual = base.residual(*self.motion(ROWS), sent=sent, policy=sent)
        np.testing.assert_allclose(residual[:, :3], 0.004 / 0.05 - 0.25, rtol=1e-12)
        np.testing.assert_array_equal(residual[:, 6], 0)

    def test_every_step_corrects_within_a_chunk(self):
        actions = np.full((ROWS, 7), 0.8, np.float32)
        for every_step in (False, True):
            following = rs.ModelFollowing(every_step=every_step)
            sent = following.correct(actions)
            position, orientation = np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1))
            commands = [following.next()]
            for row in range(1, ROWS):
                commands.append(following.next(position, orientation))
            self.assertEqual(np.array_equal(commands, sent), not every_step)

    def test_an_action_and_what_was_sent_may_be_used_again(self):
        for method in ("direct", "ours_integral", "ours_following_step"):
            sent = {}
            for reused in (False, True):
                one, stream, action = rs.Compensator(method), rs.Stream("reused"), np.zeros(7, np.float32)
                for i in range(20):
                    action = action if reused else np.zeros(7, np.float32)
                    action[:] = 0.3 * stream.normal(7)
                    command = one.step(action, [0.4 + 0.002 * i, 0, 0.2], [1, 0, 0, 0])
                    sent.setdefault(reused, []).append(command.copy())
                    if reused:
                        command[:] = 7
            np.testing.assert_array_equal(sent[False], sent[True], method)

    def test_smoothing_goes_on_from_chunk_to_chunk_and_begins_with_an_episode(self):
        smooth = rs.Compensator("smooth", smoothing=0.5)
        for _ in range(2):
            smooth.start_episode()
            commands = []
            for _ in range(2):
                smooth.correct(np.full((2, 7), 0.8, np.float32))
                commands += [smooth.next(), smooth.next()]
            np.testing.assert_allclose(np.array(commands)[:, 0], [0.4, 0.6, 0.7, 0.75], rtol=1e-6)
            np.testing.assert_allclose(np.array(commands)[:, 6], 0.8, rtol=1e-6)

    def test_actions_one_at_a_time_are_corrected_as_chunks_of_them(self):
        stream = np.random.default_rng(5)
        for method, rows in (("ours_following_smooth", None), ("ours_following_step", None), ("ours_following", 4), ("direct", 4)):
            whole, single = rs.Compensator(method), rs.Compensator(method, rows=rows)
            self.assertEqual(whole.every_step, rows is None)
            for _ in range(2):
                whole.start_episode()
                single.start_episode()
                actions = stream.uniform(-0.8, 0.8, (12, 7)).astype(np.float32)
                position = np.cumsum(stream.uniform(-0.01, 0.01, (13, 3)), axis=0)
                orientation = np.tile([1.0, 0, 0, 0], (13, 1))
                for first in range(0, 12, 4):
                    whole.correct(actions[first:first + 4])
                    for row in range(first, first + 4):
                        newest = () if row == first else (position[row - 1:row + 1], orientation[row - 1:row + 1])
                        step = single.step(actions[row], position[row], orientation[row])
                        np.testing.assert_array_equal(step, whole.next(*newest), f"{method} {row}")
                        if row == 6:
                            single = single.copy()
                    chunk = slice(first, first + 5)
                    whole.executed(position[chunk], orientation[chunk])
                single.end_episode(position[-1], orientation[-1])
                self.assertGreater(np.abs(whole.correction).max(), 0)

    def test_actions_one_at_a_time_need_where_the_arm_is(self):
        with self.assertRaisesRegex(rs.InvalidArgument, "give orientation"):
            rs.Compensator("gain").step(np.zeros(7), np.zeros(3))
        with self.assertRaisesRegex(rs.InvalidArgument, "give q"):
            rs.Compensator("direct", space="joint", action_dim=4).step(np.zeros(4), np.zeros(3), [1, 0, 0, 0])
        with self.assertRaisesRegex(rs.InvalidArgument, "position has shape"):
            rs.Compensator("gain").step(np.zeros(7), np.zeros(2), [1, 0, 0, 0])
        with self.assertRaisesRegex(rs.InvalidArgument, "rows=3 would change nothing"):
            rs.Compensator("ours_following_smooth", rows=3)

    def test_a_bad_reading_costs_its_step_and_no_other(self):
        action, position, upright = np.full(7, 0.1, np.float32), [0.4, 0, 0.3], [1, 0, 0, 0]
        direct, told = rs.Compensator("direct", rows=4), rs.Compensator("direct", rows=4)
        for i in range(12):
            for where, turn, words in (([np.nan, 0, 0], upright, r"position is \[nan, 0.0, 0.0\], must be finite"),
                                       (position, [0, 2, 0, 0], "orientation has length 2, must be 1")):
                with self.assertRaisesRegex(rs.InvalidArgument, words):
                    direct.step(action, where, turn)
            np.testing.assert_array_equal(direct.step(action, position, upright), told.step(action, position, upright))
        self.assertGreater(np.abs(direct.correction).max(), 0)
        # What only the library refuses costs the chunk before it.
        direct._steps[0]["position"][0] = np.nan
        for _ in range(4):
            with contextlib.suppress(rs.InvalidArgument):
                direct.step(action, position, upright)
        direct.step(action, position, upright)

    def test_joint_targets(self):
        direct = rs.DirectSubtraction(space="joint", action_dim=4)
        direct.correct(np.zeros((2, 4)))
        direct.executed(q=np.full((3, 3), 0.02))
        np.testing.assert_allclose(direct.correction, -0.02)
        np.testing.assert_allclose(direct.copy().correct(np.zeros((1, 4)))[0], [-0.02, -0.02, -0.02, 0], rtol=1e-6)


class Copies(unittest.TestCase):
    """A copy of an object that holds a C handle has one of its own, or is refused."""

    def test_copies_outlive_their_originals(self):
        action, where = np.full(7, 0.5, np.float32), ([0.4, 0, 0.3], [1, 0, 0, 0])
        for copied in (copy.copy, copy.deepcopy):
            first = rs.ModelFollowing(every_step=True)
            first.step(action, *where)
            second, third = copied(first), first.copy()
            self.assertIsInstance(second, rs.ModelFollowing)
            first.step(action, *where)
            del first
            gc.collect()
            np.testing.assert_array_equal(second.step(action, *where), third.step(action, *where))
            errors = rs.JointErrors("aged_joint_uniform")
            errors.reset(np.zeros(7), gravity=np.ones(7))
            twin, saved = copied(errors), errors.copy()
            errors.sub_step(np.ones(7))
            del errors
            gc.collect()
            np.testing.assert_array_equal(twin.sub_step(np.ones(7)), saved.sub_step(np.ones(7)))

    def test_what_has_no_copy_says_what_to_do(self):
        with tempfile.TemporaryDirectory() as folder, rs.EpisodeDataset(folder, cameras=[]) as data:
            cases = [(pickle.dumps, rs.JointErrors("clean"), "use copy.., and in another process make another"),
                     (pickle.dumps, rs.Compensator("base"), "use copy.., and in another process make another")]
            for copied in (copy.copy, copy.deepcopy, pickle.dumps):
                cases += [(copied, rs.Stream("x"), "make one of the same purpose"), (copied, data, "open the folder again")]
            for copied, given, words in cases:
                with self.assertRaisesRegex(TypeError, f"{type(given).__name__} cannot be copied or pickled: {words}"):
                    copied(given)


POSE = ([0.4, 0, 0.2], [1, 0, 0, 0])
PENDULUM = """<mujoco><option timestep="0.002" gravity="0 0 -9.81"/><worldbody><body><joint name="hinge" axis="0 1 0"
damping="0.2"/><inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body></worldbody></mujoco>"""


def pendulum_log(friction, seed):
    """A driven joint with Coulomb friction, 200 Hz, and what an encoder sees of it."""
    rng, h, q, dq, rows = np.random.default_rng(seed), 0.0005, 0.0, 0.0, []
    phase = rng.uniform(0, 6)
    for i in range(16000):
        t = i * h
        tau = 1.6 * np.sin(2.1 * t + phase) + 0.9 * np.sin(7.3 * t)
        if i % 10 == 0:
            rows.append((t, tau, q + 1e-4 * rng.standard_normal()))
        held = tau if i % 10 == 0 else held
        dq += h * (held - 0.2 * dq - friction * np.tanh(dq / 0.01)) / 0.05
        q += h * dq
    t, tau, q = np.array(rows).T
    return {"t": t, "tau_hinge": tau, "q_hinge": q}


class Programs(unittest.TestCase):
    def test_calibrates_arrays(self):
        rig = {"name": "pendulum", "model": PENDULUM, "rate_hz": 200,
               "joints": [{"name": "hinge", "input": "torque", "fit": ["armature", "damping"]}],
               "metric": {"type": "position_rmse", "window_s": 0.5, "unit": "rad"}}
        logs = [{"columns": pendulum_log(0.4, seed), "role": role} for seed, role in
                ((0, "fit"), (1, "fit"), (2, "held_out"))]
        report = rs.calibrate(rig, logs, program=program("CALIBRATE"), arguments=["--surrogates", "99"])
        self.assertIn(report["verdict"], ("attributed", "ambiguous", "reduced_not_attributed"))
        self.assertEqual(report["rig"], "pendulum")
        with self.assertRaisesRegex(rs.InvalidArgument, "(?s)ended with 1:.*has 2 rows, at least 50"):
            rs.calibrate(rig, [{"columns": {"t": [0, 0.005]}}], program=program("CALIBRATE"))
        with self.assertRaisesRegex(rs.InvalidArgument, r"logs\[0\] has no column t"):
            rs.calibrate(rig, [{"columns": {}}], program=program("CALIBRATE"))

    def test_nothing_of_somebody_elses_is_written_over(self):
        with tempfile.TemporaryDirectory() as folder:
            theirs = pathlib.Path(folder, "log_0.csv")
            theirs.write_text("t,q_hinge,comment\n")
            log = [{"columns": {"t": [0, 0.005]}}]
            with self.assertRaisesRegex(rs.InvalidArgument, "log_0.csv is there already .*: give another folder as out"):
                rs.calibrate({}, log, out=folder, program="true")
            self.assertEqual((theirs.read_text(), sorted(os.listdir(folder))), ("t,q_hinge,comment\n", ["log_0.csv"]))
            theirs.unlink()
            for rows in (2, 3):  # its own are
                with self.assertRaisesRegex(rs.InvalidArgument, "ended with 0"):
                    rs.calibrate({"limits": np.array([0, 1])}, [{"columns": {"t": np.arange(rows)}}], out=folder, program="true")
            self.assertEqual(len(theirs.read_text().split()), 4)
            self.assertIn('"limits": [', pathlib.Path(folder, "rig.yaml").read_text())

    def test_the_guides_example_calibrates_files(self):
        example, = guide_blocks.examples("Calibrate my arm from arrays")
        began, said = os.getcwd(), io.StringIO()
        with tempfile.TemporaryDirectory() as folder:
            pathlib.Path(folder, "arm.xml").write_text(PENDULUM)
            for seed in range(3):
                columns = pendulum_log(0.4, seed)
                np.savetxt(pathlib.Path(folder, f"run_{seed + 1}.csv"), np.column_stack(list(columns.values())), fmt="%.17g",
                           delimiter=",", header=",".join(columns), comments="")
            os.environ["ROBOSTRESS_CALIBRATE"] = program("CALIBRATE")
            os.chdir(folder)
            try:
                with contextlib.redirect_stdout(said):
                    exec(example, {})
                self.assertTrue(pathlib.Path("calibrated/report.html").exists())
            finally:
                os.chdir(began)
                del os.environ["ROBOSTRESS_CALIBRATE"]
        self.assertRegex(said.getvalue(), "^(attributed|ambiguous|reduced_not_attributed) hinge: ")

    def test_asks_a_policy_server(self):
        try:
            import msgpack  # noqa: F401
            import websockets  # noqa: F401
        except ImportError as fault:
            raise unittest.SkipTest(f"{fault.name} could not be had from PyPI")
        with tempfile.TemporaryDirectory() as folder:
            ports = pathlib.Path(folder) / "ports"
            server = subprocess.Popen(
                [program("SERVE"), "--policy", "nano", "--listen", "127.0.0.1:0", "--websocket-listen", "127.0.0.1:0",
                 "--websocket-resize", "--ports-file", str(ports)], cwd=folder, stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL)
            try:
                until = time.monotonic() + 60
                while not ports.exists() and time.monotonic() < until and server.poll() is None:
                    time.sleep(0.05)
                port, = [line.split()[1] for line in ports.read_text().splitlines() if line.startswith("websocket")]
                self.converse(f"ws://127.0.0.1:{port}")
            finally:
                server.terminate()
                server.wait()

    def converse(self, uri):
        image, state = np.zeros((224, 224, 3), np.uint8), np.zeros(8)
        observation = {"observation/image": image, "observation/wrist_image": image, "observation/state": state,
                       "prompt": "put the bowl on the plate"}
        with rs.PolicyClient(uri, method="ours_following") as client:
            self.assertEqual(client.metadata["policies"][0]["name"], "nano")
            reply = client.infer(observation, reset=True)
            self.assertEqual(reply["actions"].shape[1], 7)
            n = 5
            executed = {"q": np.zeros((n + 1, 7)), "p_base_tool": np.zeros((n + 1, 3)),
                        "q_base_tool": np.tile([1.0, 0, 0, 0], (n + 1, 1)), "gripper": np.zeros(n + 1),
                        "prediction_id": reply["adapter"]["prediction_id"], "first_step": 0, "sequence": 1}
            self.assertEqual(client.infer(observation, executed=executed)["feedback"]["sequence"], 1)
        with rs.PolicyClient(uri, method="theirs") as client:
            with self.assertRaisesRegex(rs.RobostressError, "unknown method 'theirs'"):
                client.infer(observation)


class Threads(unittest.TestCase):
    def test_objects_of_different_threads_know_nothing_of_each_other(self):
        def play(results, i):
            stream, errors = rs.Stream("threads"), rs.JointErrors("aged_transmission")
            arm, asked = drawn_arm(stream)
            errors.reset(**{k: v for k, v in arm.items() if k != "dq"})
            results[i] = [errors.sub_step(asked, **arm)[1].copy() for _ in range(300)]

        results = [None] * 4
        threads = [threading.Thread(target=play, args=(results, i)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for other in results[1:]:
            np.testing.assert_array_equal(other, results[0])


unittest.main(verbosity=1)
