"""The wrapper around dm_control's environments."""
import os
import unittest

os.environ.setdefault("MUJOCO_GL", "egl")

import dm_control
import dm_env
import mujoco
import numpy as np
from dm_control import manipulation, suite

import robostress as rs

ARM = ["root", "shoulder", "elbow", "wrist"]
NOMINAL = np.tile([0.1, 0.15, 0.1, 0.1, 0.01, 0.1, 0.1, 500, 0.5], (4, 1))


def manipulator():
    return suite.load("manipulator", "bring_ball", task_kwargs={"random": 3})


def worn(scenario="aged_joint_uniform", **more):
    return rs.wrap(manipulator(), scenario, actuators=ARM, **{**({} if scenario == "clean" else {"nominal": NOMINAL}), **more})


def play(env, steps=30):
    env.reset()
    return go_on(env, steps)


def go_on(env, steps):
    way = []
    for k in range(steps):
        env.step(0.8 * np.sin(0.3 * k + np.arange(5)))
        way.append(env.physics.data.qpos.copy())
    return np.array(way)


class DmControl(unittest.TestCase):
    def test_clean_is_the_environment_itself_to_the_last_bit(self):
        np.testing.assert_array_equal(play(worn("clean")), play(manipulator()))

    def test_errors_act_and_what_was_done_is_told(self):
        env = worn()
        self.assertGreater(np.abs(play(env) - play(manipulator())).max(), 1e-3)
        done = env.executed
        self.assertEqual(done["applied"].shape[1], 4)
        self.assertEqual(done["commanded"].shape, (5,))
        self.assertTrue((done["applied"] != done["asked"]).any())
        np.testing.assert_array_equal(done["q"], env.physics.data.qpos[:4])
        np.testing.assert_allclose(done["asked"][0], env.physics.model.actuator_gear[:4, 0] * done["commanded"][:4])

    def test_an_episode_begins_anew_also_where_a_step_begins_it(self):
        env = suite.load("manipulator", "bring_ball", task_kwargs={"random": 3, "time_limit": 0.3})
        env = rs.wrap(env, "aged_joint_uniform", actuators=ARM, nominal=NOMINAL)
        env.reset()
        while not env.step(np.full(5, 0.3)).last():
            pass
        self.assertTrue(env.step(np.zeros(5)).first())
        before = env.executed
        self.assertGreater(np.abs(env.errors.offset()).max(), 0, "of the episode before, until the first step")
        env.step(np.zeros(5))
        self.assertIsNot(env.executed, before)
        np.testing.assert_array_equal(env.executed["commanded"], np.zeros(5))
        self.assertEqual(env._episode.steps, 1)

    def test_an_arm_of_the_composer_with_servos(self):
        names = [f"jaco_arm/joint_{i}" for i in range(1, 7)]

        def way(env):
            env.reset()
            played = []
            for k in range(15):
                env.step(0.3 * np.sin(0.3 * k + np.arange(9)))
                played.append(env.physics.data.qpos.copy())
            return np.array(played)
        bare = way(manipulation.load("reach_site_features", seed=1))
        clean = rs.wrap(manipulation.load("reach_site_features", seed=1), "clean", actuators=names)
        np.testing.assert_array_equal(way(clean), bare)
        rubbing = rs.wrap(manipulation.load("reach_site_features", seed=1), "isolated_stribeck", actuators=names,
                          nominal=np.tile(NOMINAL[0], (6, 1)))
        self.assertGreater(np.abs(way(rubbing) - bare).max(), 1e-4)
        self.assertFalse(rubbing.physics.data.qfrc_applied.any())

    def test_it_can_be_taken_off(self):
        env = worn()
        play(env, 5)
        bare = env.unwrap()
        other = manipulator()
        play(other, 5)
        np.testing.assert_array_equal(play(bare), play(other))
        self.assertNotIn("step", vars(bare.physics))

    def test_what_others_replaced_stays(self):
        env, calls = manipulator(), []
        step, physics_step = env.step, env.physics.step
        env.step = mine = lambda action: (calls.append(1), step(action))[1]
        env.physics.step = theirs = lambda nstep=1: physics_step(nstep)
        wrapped = rs.wrap(env, "clean", actuators=ARM)
        play(wrapped, 2)
        wrapped.unwrap()
        self.assertIs(env.step, mine)
        self.assertIs(vars(env.physics)["step"], theirs)
        self.assertNotIn("reset", vars(env))
        self.assertEqual(len(calls), 2)

    def test_an_environment_that_steps_mujoco_itself_is_told_so(self):
        env = manipulator()
        env.step = lambda action: dm_env.transition(0.0, {})
        wrapped = rs.wrap(env, "clean", actuators=ARM)
        wrapped.reset()
        with self.assertRaisesRegex(rs.InvalidArgument, "step.. did not step through physics.step, .*ask JointErrors"):
            wrapped.step(np.zeros(5))

    def test_says_what_cannot_be_wrapped(self):
        env = manipulator()
        for scenario, more, words in (("clean", {}, "actuators is empty"),
                                      ("clean", {"actuators": ["knee"]}, "actuator 'knee' is not in the model"),
                                      ("aged_transmission", {"actuators": ARM}, "seven joints of a Panda"),
                                      ("clean", {"actuators": ["grasp"]}, "is no motor or servo of one hinge")):
            with self.assertRaisesRegex(rs.RobostressError, words):
                rs.wrap(env, scenario, **more)
        wrapped = rs.wrap(env, "clean", actuators=ARM)
        with self.assertRaisesRegex(rs.InvalidArgument, "wrapped already"):
            rs.wrap(env, "clean", actuators=ARM)
        wrapped.close()


print(f"dm_control {getattr(dm_control, '__version__', '1.0.27')}, MuJoCo {mujoco.__version__}", flush=True)
unittest.main(verbosity=1)
