#!/usr/bin/env python3
"""The wrapper around robosuite's environments, 1.4 and 1.5: what it changes, and what it refuses."""
import copy
import functools
import logging
import pickle
import unittest
import unittest.mock

import mujoco
import numpy as np
import robosuite
from robosuite.utils.binding_utils import MjSim

import robostress as rs

PARTS = not hasattr(robosuite, "load_controller_config")  # 1.5
logging.disable(logging.WARNING)


def make(task="Lift", robots="Panda", **more):
    if not PARTS:
        more["controller_configs"] = robosuite.load_controller_config(default_controller="OSC_POSE")
    return robosuite.make(task, robots=robots, has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False,
                          control_freq=20, horizon=1000, **more)


def play(env, steps=6):
    np.random.seed(3)
    env.reset()
    return go_on(env, steps)


def go_on(env, steps):
    played, info = [], {}
    for k in range(steps):
        info = env.step(0.3 * np.sin(0.3 * k + np.arange(env.action_dim)))[-1]
        played.append(np.array(env.sim.data.qpos))
    return np.array(played), info


class Gravity:
    """An arm's gravity torques, in NumPy."""

    def __init__(self, sim, joints):
        self.m, self.d, self.joints = sim.model._model, sim.data._data, joints

    def __call__(self):
        body = self.m.jnt_bodyid[self.joints]
        moment = np.cross(self.d.subtree_com[body] - self.d.xanchor[self.joints], self.m.opt.gravity)
        return -self.m.body_subtreemass[body] * (moment * self.d.xaxis[self.joints]).sum(axis=1)


class Wrapped(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.env = make()

    def wrap(self, scenario, **more):
        wrapped = rs.wrap(self.env, scenario, **more)
        self.addCleanup(wrapped.unwrap)
        return wrapped

    def test_without_errors_nothing_changes(self):
        for more in ({}, {"hard_reset": False}) + (({"lite_physics": False},) if PARTS else ()):
            env = make(**more)
            play(env)  # what the first reset alone does
            before, _ = play(env)
            wrapped = rs.wrap(env, "clean")
            np.testing.assert_array_equal(play(wrapped)[0], before, err_msg=str(more))
            self.assertIs(wrapped.unwrap(), env)
            self.assertNotIn("step", vars(env))
            self.assertNotIn("step", vars(env.sim))
            np.testing.assert_array_equal(play(env)[0], before)

    def test_sub_steps_are_those_of_joint_errors(self):
        wrapped, twin, moments = self.wrap("aged_transmission"), rs.JointErrors("aged_transmission", horizon=1000), []
        np.random.seed(3)
        wrapped.reset()
        env, pre_action = self.env, self.env._pre_action
        robot = env.robots[0]
        joints = robot._ref_joints_indexes_dict["right"] if PARTS else robot._ref_joint_indexes
        controller = robot.part_controllers["right"] if PARTS else robot.controller
        gravity, sim, name = Gravity(env.sim, joints), env.sim, "step2" if PARTS else "step"
        twin.bind(torque_low=np.array(robot.torque_limits[0][:7]), torque_high=np.array(robot.torque_limits[1][:7]))
        twin.reset(sim.data.qpos[:7], holding=gravity(), gravity=gravity())

        def watched_pre_action(action, policy_step=False):
            pre_action(action, policy_step)
            if policy_step:
                twin.begin_control_step(len(moments) // 25)
            applied, change = twin.sub_step(controller.torques, q=sim.data.qpos[:7], dq=sim.data.qvel[:7], gravity=gravity())
            moments.append((applied.copy(), sim.data.qpos[:7] + change))

        physics = getattr(MjSim, name)

        def watched_physics(sim):
            applied, q = moments[-1]
            np.testing.assert_allclose(sim.data.ctrl[:7], applied, rtol=0, atol=1e-11)
            np.testing.assert_allclose(sim.data.qpos[:7], q, rtol=0, atol=1e-13)
            physics(sim)

        env._pre_action = watched_pre_action
        setattr(MjSim, name, watched_physics)
        try:
            _, info = go_on(wrapped, 4)
        finally:
            setattr(MjSim, name, physics)
            del env._pre_action
        self.assertEqual(len(moments), 100)
        np.testing.assert_allclose(info["robostress"]["applied"], [m[0] for m in moments[-25:]], rtol=0, atol=1e-11)
        self.assertGreater(np.abs(info["robostress"]["applied"] - info["robostress"]["asked"]).max(), 0.1)
        np.testing.assert_array_equal(info["robostress"]["q"], sim.data.qpos[:7])

    def test_what_others_replaced_stays(self):
        env, calls = make(hard_reset=False), []
        name = "step2" if PARTS else "step"
        step, physics = env.step, getattr(env.sim, name)
        env.step = lambda action: step(action)
        setattr(env.sim, name, lambda: calls.append(physics()))
        mine = env.step, getattr(env.sim, name)
        wrapped = rs.wrap(env, "clean")
        wrapped.reset()
        wrapped.step(np.zeros(env.action_dim))
        wrapped.unwrap()
        self.assertEqual(len(calls), 25)
        self.assertEqual((env.step, getattr(env.sim, name)), mine)

    def test_what_is_replaced_in_mid_episode_counts(self):
        wrapped, calls = self.wrap("aged_transmission"), []
        wrapped.reset()
        go_on(wrapped, 2)
        sim, robot, name = self.env.sim, self.env.robots[0], "step2" if PARTS else "step"
        physics = getattr(sim, name)
        setattr(sim, name, lambda: calls.append(physics()))
        go_on(wrapped, 1)
        delattr(sim, name)
        go_on(wrapped, 1)
        self.assertEqual(len(calls), 25)
        class Spy(list):  # empty: false
            def __call__(self, *given):
                calls.append(given)
        before = len(calls)
        setattr(sim, name, Spy())
        go_on(wrapped, 1)
        delattr(sim, name)
        of_class = vars(MjSim)[name]
        for put in (Spy(), staticmethod(Spy()), functools.wraps(of_class)(lambda sim: calls.append(()))):
            setattr(MjSim, name, put)
            try:
                go_on(wrapped, 1)
            finally:
                setattr(MjSim, name, of_class)
        with unittest.mock.patch.object(mujoco, "mj_" + name, Spy()):
            go_on(wrapped, 1)
        go_on(wrapped, 1)
        self.assertEqual(len(calls) - before, 5 * 25)
        self.assertEqual([len(given) for given in calls[before:]], 100 * [0] + 25 * [2])
        mine = copy.copy(robot.part_controllers["right"] if PARTS else robot.controller)
        if PARTS:
            robot.part_controllers["right"] = mine
        else:
            robot.controller = mine
        _, info = go_on(wrapped, 1)
        np.testing.assert_array_equal(info["robostress"]["asked"][-1], mine.torques)

    def test_an_episode_begins_at_each_reset(self):
        wrapped = self.wrap("aged_transmission")
        first, _ = play(wrapped)
        np.random.seed(3)
        self.env.reset()  # in mid-episode, past the wrapper
        np.testing.assert_array_equal(go_on(wrapped, 6)[0], first)
        self.assertEqual(wrapped._episode.steps, 6)

    def test_environments_do_not_share_errors(self):
        other = make()
        alone, _ = play(self.wrap("aged_transmission"))
        one, two = self.wrap_anew("aged_transmission"), rs.wrap(other, "nominal")
        np.random.seed(3)
        one.reset()
        np.random.seed(3)
        two.reset()
        together = []
        for k in range(6):
            action = 0.3 * np.sin(0.3 * k + np.arange(self.env.action_dim))
            one.step(action)
            two.step(action)
            together.append(np.array(self.env.sim.data.qpos))
        np.testing.assert_array_equal(together, alone)

    def wrap_anew(self, scenario):
        self.doCleanups()
        return self.wrap(scenario)

    def test_two_robots_have_their_own_errors(self):
        env = make("TwoArmLift", ["Panda", "Panda"])
        both = rs.wrap(rs.wrap(env, "aged_transmission"), "clean", robot=1)
        _, info = play(both)
        bent, clean = info["robostress"], info["robostress_1_right"]
        self.assertGreater(np.abs(bent["applied"] - bent["asked"]).max(), 0.1)
        np.testing.assert_array_equal(clean["applied"], np.clip(clean["asked"], [-80] * 5 + [-12] * 2, [80] * 5 + [12] * 2))
        self.assertFalse(np.array_equal(bent["q"], clean["q"]))

    def test_an_arm_is_taken_off_once(self):
        env = make("TwoArmLift", ["Panda", "Panda"])
        first, other = rs.wrap(env, "clean"), rs.wrap(env, "clean", robot=1)
        first.unwrap()
        later = rs.wrap(env, "aged_transmission")
        first.unwrap()
        _, info = play(later, 1)
        self.assertGreater(np.abs(info["robostress"]["applied"] - info["robostress"]["asked"]).max(), 0.1)
        for wrapped in (later, other):
            wrapped.unwrap()
        self.assertNotIn("step", vars(env))

    def test_closes_once_and_copies_never(self):
        wrapped = rs.wrap(make(), "aged_transmission")
        wrapped.reset()
        for copied in (copy.copy, copy.deepcopy, pickle.dumps):
            with self.assertRaisesRegex(TypeError, "wrapped Lift cannot be copied or pickled: .* make another"):
                copied(wrapped)
        with self.assertRaisesRegex(TypeError, "cannot be copied or pickled: .* unwrap.. it before"):
            copy.deepcopy(vars(wrapped._wrapped)["step"])
        wrapped.close()
        wrapped.close()
        with self.assertRaisesRegex(rs.WrongOrder, "closed"):
            wrapped.step(np.zeros(7))

    def test_other_arms_bring_their_values(self):
        env = make(robots="UR5e")
        with self.assertRaisesRegex(rs.InvalidArgument, "the arm has 6; give its own"):
            rs.wrap(env, "aged_joint_uniform")
        nominal = np.tile([1, 1.5, 0.1, 1, 0.01, 1, 1, 5000, 0.5], (6, 1))
        _, info = play(rs.wrap(env, "aged_joint_uniform", nominal=nominal))
        self.assertEqual(info["robostress"]["applied"].shape, (25, 6))
        with self.assertRaisesRegex(rs.InvalidArgument, "has values for a Panda, the arm is another"):
            rs.wrap(make(robots="IIWA"), "aged_transmission")

    def test_says_what_cannot_be_wrapped(self):
        for refused, words in (
                (dict(scenario="worn"), "known: clean"), (dict(scenario="nominal", severity=6), "severity level 6"),
                (dict(scenario="nominal", robot=1), "robot is 1, must be 0 to 0"),
                (dict(scenario="nominal", robot="0"), "robot is '0', must be a whole number"),
                (dict(scenario="nominal", arm="left"), "arm is 'left'")):
            with self.assertRaisesRegex(rs.RobostressError, words):
                rs.wrap(self.env, **refused)
        self.wrap("nominal")
        with self.assertRaisesRegex(rs.InvalidArgument, "robot 0's right arm is wrapped already"):
            rs.wrap(self.env, "clean")
        with self.assertRaisesRegex(rs.InvalidArgument, "object cannot be wrapped"):
            rs.wrap(object(), "clean")

    @unittest.skipUnless(PARTS, "its wrapper needs gym in 1.4")
    def test_goes_through_robosuites_own_wrappers(self):
        import gymnasium
        from robosuite.wrappers import GymWrapper
        wrapped = rs.wrap(GymWrapper(make()), "aged_transmission")
        self.assertIsInstance(wrapped, gymnasium.Env)
        wrapped.reset(seed=1)
        _, _, _, _, info = wrapped.step(np.full(7, 0.2))
        self.assertGreater(np.abs(info["robostress"]["applied"] - info["robostress"]["asked"]).max(), 0.1)

    def test_arms_of_one_robot(self):
        env = make("TwoArmLift", "Baxter")
        healthy, _ = play(env)
        clean = rs.wrap(env, "clean", arm="left")
        same, info = play(clean)
        self.assertEqual(info["robostress_0_left"]["asked"].shape, (25, 7))
        np.testing.assert_array_equal(same, healthy)
        clean.unwrap()
        joints = {arm: [j for j in range(env.sim.model.njnt) if env.sim.model.joint_id2name(j).startswith(f"robot0_{arm}_")]
                  for arm in ("left", "right")}
        addresses = {arm: env.sim.model.jnt_qposadr[numbers] for arm, numbers in joints.items()}
        nominal = np.tile([2, 3, 0.1, 2, 0.02, 1, 0.1, 500, 0.5], (7, 1))
        for arm, other in (("left", "right"), ("right", "left")):
            worn = rs.wrap(env, "aged_transmission", arm=arm, nominal=nominal)
            moved, info = play(worn)
            name = "robostress" if arm == "right" else "robostress_0_left"
            self.assertGreater(np.abs(info[name]["applied"] - info[name]["asked"]).max(), 0.1)
            off = {part: np.abs(moved - healthy)[:, numbers].max() for part, numbers in addresses.items()}
            self.assertGreater(off[arm], 20 * off[other], off)
            worn.unwrap()
        with self.assertRaisesRegex(rs.InvalidArgument, "arm is 'middle'"):
            rs.wrap(env, "clean", arm="middle")


unittest.main(verbosity=1)
