#!/usr/bin/env python3
"""The wrapper around Gymnasium's MuJoCo environments, and the same bits on every MuJoCo."""
import copy
import pathlib
import pickle
import tempfile
import unittest

import gymnasium
import gymnasium.envs.mujoco
import mujoco
import numpy as np
from gymnasium.utils.env_checker import check_env

import robostress as rs
from robostress.mujoco_arm import MujocoArm

SHOULDER_TO_WRIST = ["r_shoulder_pan_joint", "r_shoulder_lift_joint", "r_upper_arm_roll_joint", "r_elbow_flex_joint",
                     "r_forearm_roll_joint", "r_wrist_flex_joint", "r_wrist_roll_joint"]
NOMINAL = np.tile([0.1, 0.15, 0.1, 0.1, 0.01, 0.1, 0.1, 500, 0.5], (7, 1))
CHEETAH = ["bthigh", "bshin", "bfoot"]


def pusher(scenario="aged_joint_uniform", **more):
    return rs.wrap(gymnasium.make("Pusher-v5"), scenario, actuators=SHOULDER_TO_WRIST,
                   **{**({} if scenario == "clean" else {"nominal": NOMINAL}), **more})


def play(env, steps=20):
    env.reset(seed=5)
    return go_on(env, steps)


def go_on(env, steps):
    played = []
    for k in range(steps):
        action = 0.8 * np.sin(0.3 * k + np.arange(env.action_space.shape[0]))
        played.append(env.step(action.astype(np.float32))[0])
    return np.array(played)


def chain():
    """An arm of seven motors, a site at its end."""
    inside = '<site name="tool" pos="0 0 0.1"/>'
    for i in reversed(range(7)):
        inside = (f'<body pos="0.01 0 0.2"><joint name="j{i}" axis="{i % 2} {1 - i % 2} 0"/>'
                  f'<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.2"/>{inside}</body>')
    motors = "".join(f'<motor name="m{i}" joint="j{i}" ctrllimited="true" ctrlrange="-80 80"/>' for i in range(7))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="0.002"/><worldbody>{inside}</worldbody><actuator>{motors}</actuator></mujoco>')
    return model, mujoco.MjData(model)


def xml_of(actuators, gear=1, joint=""):
    """Three joints, their actuators and further attributes as given for each."""
    inside = ""
    for i in reversed(range(3)):
        inside = (f'<body pos="0 0 0.25"><joint name="j{i}" axis="0 1 0" armature="0.05" damping="0.3" {joint}/>'
                  f'<geom type="capsule" size="0.03" fromto="0 0 0 0 0 0.25" contype="0" conaffinity="0"/>{inside}</body>')
    return (f'<mujoco><option timestep="0.002"/><worldbody>{inside}</worldbody><actuator>'
            + "".join(actuators.format(i=i, gear=gear) for i in range(3)) + "</actuator></mujoco>")


class ThreeJoints(gymnasium.envs.mujoco.MujocoEnv):
    metadata = {"render_modes": ["human", "rgb_array", "depth_array"], "render_fps": 50}
    if not gymnasium.__version__.startswith("1.0"):
        metadata["render_modes"].append("rgbd_tuple")

    def __init__(self, file):
        super().__init__(file, 10, gymnasium.spaces.Box(-np.inf, np.inf, (6,)))

    def step(self, action):
        self.do_simulation(action, self.frame_skip)
        return np.concatenate([self.data.qpos, self.data.qvel]), 0.0, False, False, {}

    def reset_model(self):
        self.set_state(self.init_qpos, self.init_qvel)
        return np.zeros(6)


class Servos(unittest.TestCase):
    """A servo in the model beside the same law in a program and a motor."""
    POSITION = '<position joint="j{i}" kp="60" kv="4" gear="{gear}" forcerange="-30 30" ctrlrange="-2 2" ctrllimited="true"/>'
    MOTOR = '<motor joint="j{i}"/>'

    def played(self, actuators, scenario, law=None, gear=1, steps=40, wrapped=True, joint=""):
        model = mujoco.MjModel.from_xml_string(xml_of(actuators, gear, joint))
        data = mujoco.MjData(model)
        arm = MujocoArm(model, data, range(3), range(3), rs.JointErrors(scenario, 3, nominal=NOMINAL[:3]), rows=10)
        arm.begin_episode()
        way = []
        for k in range(steps):
            target = 0.6 * np.sin(0.1 * k + np.arange(3))
            arm.errors.begin_control_step(k, False)
            act = arm.actor(arm)
            for _ in range(10):
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                data.ctrl[:] = target / gear if law is None else law(target, data.qpos, data.qvel)
                if wrapped:
                    act()
                mujoco.mj_step(model, data)
                way.append(data.qpos.copy())
            arm.end_control_step()
            self.assertFalse(data.qfrc_applied.any())
        return np.array(way)

    @staticmethod
    def law(gear):
        # MuJoCo's position servo: force = kp (ctrl - length) - kv speed, length = gear q, and its torque gear times that.
        return lambda target, q, dq: gear * np.clip(60 * (np.clip(target / gear, -2, 2) - gear * q) - 4 * gear * dq, -30, 30)

    @unittest.skipIf(mujoco.__version__.startswith("2"), "<position kv=...> came with MuJoCo 3")
    def test_a_servo_is_bent_as_its_law_in_a_program_is(self):
        for gear in (1, 2.5):
            for scenario in ("isolated_gravity", "isolated_stribeck", "isolated_backlash", "isolated_compliance"):
                servo = self.played(self.POSITION, scenario, gear=gear)
                motor = self.played(self.MOTOR, scenario, self.law(gear))
                self.assertLess(np.abs(servo - motor).max(), 1e-11, (gear, scenario))
                clean = self.played(self.POSITION, "clean", gear=gear)
                self.assertGreater(np.abs(servo - clean).max(), 1e-4, (gear, scenario))

    @unittest.skipIf(mujoco.__version__.startswith("2"), "<position kv=...> came with MuJoCo 3")
    def test_a_joints_own_limit_is_one_of_what_drives_it(self):
        for actuator, law in ((self.MOTOR, lambda target, q, dq: 9 * target), (self.POSITION, None)):
            narrow = actuator.replace('forcerange="-30 30"', "").replace("/>", ' forcerange="-1 1"/>')
            for scenario in ("isolated_compliance", "isolated_gravity"):
                limited = self.played(actuator, scenario, law, joint='actuatorfrcrange="-1 1"')
                self.assertLess(np.abs(limited - self.played(narrow, scenario, law)).max(), 1e-11, scenario)
                self.assertGreater(np.abs(limited - self.played(actuator, scenario, law)).max(), 1e-3, scenario)

    @unittest.skipIf(mujoco.__version__.startswith("2"), "<position kv=...> came with MuJoCo 3")
    def test_an_environment_of_servos_is_wrapped(self):
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "arm.xml")
            file.write_text(xml_of(self.POSITION))
            way = lambda env: np.array([env.step(0.5 * np.sin(0.1 * k + np.arange(3)))[0] for k in range(30)])  # noqa: E731
            bare, clean, worn = ThreeJoints(str(file)), ThreeJoints(str(file)), ThreeJoints(str(file))
            names = ["j0", "j1", "j2"]
            wrapped = (rs.wrap(clean, "clean", actuators=names),
                       rs.wrap(worn, "isolated_stribeck", actuators=names, nominal=NOMINAL[:3]))
            for env in (bare, *wrapped):
                env.reset(seed=1)
            expected = way(bare)
            np.testing.assert_array_equal(way(wrapped[0]), expected)
            self.assertGreater(np.abs(way(wrapped[1]) - expected).max(), 1e-4)
            _, _, _, _, info = wrapped[1].step(np.full(3, 0.2))
            self.assertEqual(info["robostress"]["applied"].shape, (10, 3))
            self.assertTrue((info["robostress"]["applied"] != info["robostress"]["asked"]).any())
            self.assertFalse(worn.data.qfrc_applied.any())

    @unittest.skipIf(mujoco.__version__.startswith("2"), "<position kv=...> came with MuJoCo 3")
    def test_without_errors_it_is_itself_to_the_last_bit(self):
        for gear in (1, 2.5):
            bare = self.played(self.POSITION, "clean", gear=gear, wrapped=False)
            np.testing.assert_array_equal(self.played(self.POSITION, "clean", gear=gear), bare)


class Bits(unittest.TestCase):
    def test_equal_inputs_give_equal_bits_whatever_mujoco(self):
        """Beside the library alone, in arrays that no MuJoCo has seen."""
        model, data = chain()
        for scenario in rs.scenarios():
            draws = rs.Stream("bits", 1, scenario.name)
            arm = MujocoArm(model, data, range(7), range(7), rs.JointErrors(scenario.name), tool=0,
                            pads=([0], [1]), rows=25)
            plain = {name: np.zeros_like(getattr(data, name)) for name in ("qpos", "qvel", "ctrl", "xaxis", "xanchor",
                                                                           "subtree_com")}
            alone, tool = rs.JointErrors(scenario.name), np.zeros(3)
            alone.bind(torque_low=np.full(7, -80.0), torque_high=np.full(7, 80.0))
            mass = model.body_subtreemass.copy()
            alone.attach(model.opt.gravity.copy(), rows=25, tool=tool, subtree_mass=mass, qpos_index=range(7),
                         dof_index=range(7), ctrl_index=range(7), joint_index=range(7), body_index=range(1, 8), **plain)
            for k in range(75):
                asked = 10 * draws.normal(7)
                given = {name: draws.normal(values.size).reshape(values.shape) for name, values in plain.items()}
                if k > 0:
                    given["qpos"] = data.qpos + 1e-3 * given["qpos"]
                for name, values in given.items():
                    plain[name][...] = values
                    getattr(data, name)[...] = values
                tool[:] = data.site_xpos[0] = draws.normal(3)
                if k == 0:
                    arm.begin_episode()
                    alone.reset_attached(0.002)
                for errors in (arm.errors, alone):
                    if k % 25 == 0:
                        errors.begin_control_step(k // 25, held=True)
                    errors.act(asked)
                np.testing.assert_array_equal(data.ctrl, plain["ctrl"], err_msg=scenario.name)
                np.testing.assert_array_equal(data.qpos, plain["qpos"], err_msg=scenario.name)
            np.testing.assert_array_equal(arm.errors.record, alone.record)


class Gymnasium(unittest.TestCase):
    def test_without_errors_nothing_changes(self):
        for name, actuators in (("Pusher-v5", SHOULDER_TO_WRIST), ("HalfCheetah-v5", CHEETAH), ("Reacher-v5", ["joint0"])):
            env = gymnasium.make(name)
            before = play(env)
            wrapped = rs.wrap(env, "clean", actuators=actuators)
            np.testing.assert_array_equal(play(wrapped), before, err_msg=name)
            self.assertIs(wrapped.unwrap(), env)
            self.assertNotIn("step", vars(env.unwrapped))
            np.testing.assert_array_equal(play(env), before)

    def test_info_tells_what_became_of_a_command(self):
        env = pusher()
        env.reset(seed=5)
        action = np.full(7, 1.5, np.float32)
        told = env.step(action)[-1]["robostress"]
        np.testing.assert_array_equal(told["commanded"], action)
        np.testing.assert_array_equal(told["asked"], np.full((5, 7), 1.5))
        self.assertGreater(np.abs(told["applied"] - told["asked"]).max(), 0.05)
        np.testing.assert_array_equal(told["q"], env.unwrapped.data.qpos[:7])
        self.assertGreater(np.abs(play(env) - play(pusher("clean"))).max(), 1e-3)

    def test_gears_turn_commands_into_torques(self):
        env = rs.wrap(gymnasium.make("HalfCheetah-v5"), "clean", actuators=CHEETAH)
        env.errors.add_effect(0, "motor_gain", [-0.75])
        env.reset(seed=5)
        for _ in range(3):
            told = env.step(np.full(6, 0.5, np.float32))[-1]["robostress"]
        np.testing.assert_array_equal(told["asked"], np.tile([60.0, 45, 30], (5, 1)))
        np.testing.assert_allclose(told["applied"], np.tile([15.0, 45, 30], (5, 1)))
        np.testing.assert_allclose(env.unwrapped.data.ctrl, [0.125, 0.5, 0.5, 0.5, 0.5, 0.5])

    def test_friction_that_sticks_reads_masses(self):
        env = rs.wrap(gymnasium.make("HalfCheetah-v5"), "clean", actuators=CHEETAH)
        env.errors.add_effect(0, "stribeck_friction", [8.0, 12, 0.1, 0.5])
        env.reset(seed=5)
        for k in range(10):
            told = env.step(np.full(6, 0.5 * (-1)**k, np.float32))[-1]["robostress"]
        self.assertIn("mass_matrix", env.errors.reads)
        lost = np.abs(told["asked"] - told["applied"])
        self.assertGreater(lost[:, 0].max(), 1)
        np.testing.assert_array_equal(lost[:, 1:], 0)

    def test_friction_that_brings_joints_to_rest_reads_masses(self):
        stick, slide = play(pusher(friction_law="stick")), play(pusher())
        self.assertTrue(np.isfinite(stick).all())
        self.assertGreater(np.abs(stick - slide).max(), 1e-6)

    def test_masses_are_those_of_the_model(self):
        model, data = chain()
        data.qpos[:] = 0.3 * np.arange(7)
        mujoco.mj_forward(model, data)
        arm = MujocoArm(model, data, range(2, 7), range(2, 7), rs.JointErrors("clean", 5))
        expected = np.zeros((7, 7))
        for column, unit in zip(expected, np.eye(7)):
            mujoco.mj_mulM(model, data, column, unit)
        np.testing.assert_allclose(arm._mass_matrix(), expected[2:, 2:], rtol=1e-12)

    def test_what_others_replaced_stays(self):
        env, calls = gymnasium.make("Pusher-v5"), []
        base, step = env.unwrapped, env.unwrapped.step
        base.step = mine = lambda action: (calls.append(1), step(action))[1]
        wrapped = rs.wrap(env, "clean", actuators=SHOULDER_TO_WRIST)
        play(wrapped, 2)
        wrapped.unwrap()
        self.assertIs(base.step, mine)
        self.assertNotIn("set_state", vars(base))
        play(env, 1)
        self.assertEqual(len(calls), 3)

    def test_an_environment_that_steps_mujoco_itself_is_told_so(self):
        class Own(ThreeJoints):
            def step(self, action):
                self.data.ctrl[:] = action
                mujoco.mj_step(self.model, self.data, self.frame_skip)
                return np.zeros(6), 0.0, False, False, {}

        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "arm.xml")
            file.write_text(xml_of('<motor joint="j{i}"/>'))
            env = rs.wrap(Own(str(file)), "clean", actuators=["j0", "j1", "j2"])
            env.reset(seed=1)
            with self.assertRaisesRegex(rs.InvalidArgument, "Own.step.. did not step through .*ask JointErrors"):
                env.step(np.zeros(3))

    def test_an_episode_begins_at_each_reset(self):
        env = pusher()
        first = play(env)
        env.unwrapped.reset(seed=5)  # in mid-episode, past the wrapper
        np.testing.assert_array_equal(go_on(env, 20), first)

    def test_is_a_gymnasium_environment(self):
        env = pusher()
        self.assertIsInstance(env, gymnasium.Env)
        check_env(env, skip_render_check=True)
        several = gymnasium.vector.AsyncVectorEnv([pusher, pusher])
        several.reset(seed=[5, 5])
        seen = several.step(np.full((2, 7), 0.5, np.float32))[0]
        several.close()
        np.testing.assert_array_equal(seen[0], seen[1])

    def test_closes_once_and_copies_never(self):
        env = pusher()
        for copied in (copy.deepcopy, pickle.dumps):
            with self.assertRaisesRegex(TypeError, "cannot be copied or pickled"):
                copied(env)
        env.close()
        env.close()
        with self.assertRaisesRegex(rs.WrongOrder, "closed"):
            env.step(np.zeros(7, np.float32))

    def test_after_unwrapping_only_what_was_wrapped_steps(self):
        env = pusher()
        env.reset(seed=5)
        inside = env.unwrap()
        with self.assertRaisesRegex(rs.WrongOrder, "unwrapped: step what unwrap.. returned"):
            env.step(np.zeros(7, np.float32))
        inside.step(np.zeros(7, np.float32))

    def test_tells_of_the_sub_steps_that_were_played_and_of_no_copy(self):
        with tempfile.TemporaryDirectory() as folder:
            file = pathlib.Path(folder, "arm.xml")
            file.write_text(xml_of('<motor name="m{i}" joint="j{i}" gear="{gear}"/>'))
            env = ThreeJoints(str(file))
            wrapped = rs.wrap(env, "nominal", actuators=["m0", "m1", "m2"], nominal=NOMINAL[:3])
        wrapped.reset(seed=1)
        with self.assertRaisesRegex(TypeError, "cannot be copied or pickled: .* unwrap.. it before"):
            copy.deepcopy(env)  # its errors would be the original's
        for frames, action, told in ((10, 2, 10), (5, 0, 5), (20, 1, 10)):
            env.frame_skip = frames
            info = wrapped.step(np.full(3, action, np.float32))[-1]["robostress"]
            np.testing.assert_array_equal(info["asked"], np.full((told, 3), action))
            self.assertEqual(info["applied"].shape, (told, 3))

    def test_says_what_cannot_be_wrapped(self):
        env = gymnasium.make("Pusher-v5")
        for scenario, more, words in (
                ("clean", {}, "actuators is empty"),
                ("clean", {"actuators": SHOULDER_TO_WRIST, "settle_steps": 10.0}, "settle_steps is 10.0, must be a whole"),
                ("clean", {"actuators": SHOULDER_TO_WRIST, "settle_steps": -5}, "settle_steps is -5, must be 0 to"),
                ("clean", {"actuators": ["elbow"]}, "'elbow' is not in .*r_elbow_flex"),
                ("clean", {"actuators": "elbow"}, "'elbow' is not in .*r_elbow_flex"),
                ("clean", {"actuators": np.array(SHOULDER_TO_WRIST[:1] * 2)}, "names 'r_shoulder_pan_joint' twice"),
                ("nominal", {"actuators": SHOULDER_TO_WRIST}, "the arm is another: give its own, nominal="),
                ("heavy_payload", {"actuators": SHOULDER_TO_WRIST, "nominal": NOMINAL}, "depends on a grasp|where it sits"),
                ("clean", {"actuators": SHOULDER_TO_WRIST, "tool": "hand"}, "site 'hand' is not in")):
            with self.assertRaisesRegex(rs.RobostressError, words):
                rs.wrap(env, scenario, **more)
        wrapped = rs.wrap(env, "clean", actuators=SHOULDER_TO_WRIST)
        with self.assertRaisesRegex(rs.InvalidArgument, "wrapped already"):
            rs.wrap(wrapped, "clean", actuators=SHOULDER_TO_WRIST)
        with self.assertRaisesRegex(rs.InvalidArgument, "no environment of robosuite, of Gym"):
            rs.wrap(gymnasium.make("CartPole-v1"), "clean", actuators=["cart"])
        model = mujoco.MjModel.from_xml_string(
            '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody>'
            '<actuator><intvelocity joint="j" kp="9" actrange="-1 1"/></actuator></mujoco>')
        with self.assertRaisesRegex(rs.InvalidArgument, "actuator 0 at joint 0 of the model is no motor or servo"):
            MujocoArm(model, mujoco.MjData(model), [0], [0], rs.JointErrors("clean", 1))


print(f"Gymnasium {gymnasium.__version__}, MuJoCo {mujoco.__version__}", flush=True)
unittest.main(verbosity=1)
