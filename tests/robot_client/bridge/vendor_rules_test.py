#!/usr/bin/env python3
"""What the drivers of LeRobot and ROS 2 make of an arm that is not as it was: no power, an old goal, old stamps."""

import logging
import os
import subprocess
import sys
import tempfile
import time
import types
import unittest

HERE = os.path.dirname(os.path.abspath(__file__))
DEPLOY = os.path.join(HERE, "../../../deploy")
sys.dont_write_bytecode = True
sys.path[:0] = [DEPLOY, os.path.join(HERE, "ros_stand_in")]

import rclpy
import robostress_bridge as bridge
import robostress_bridge_lerobot as lerobot_driver
import robostress_bridge_ros2 as ros2_driver
from sensor_msgs.msg import JointState

logging.disable(logging.CRITICAL)


class Bus:
    """A bus of LeRobot's, as far as the driver asks it: registers in counts."""

    def __init__(self, known=("Present_Position", "Goal_Position", "Torque_Enable")):
        mode = types.SimpleNamespace(norm_mode=types.SimpleNamespace(name="DEGREES"))
        jaw = types.SimpleNamespace(norm_mode=types.SimpleNamespace(name="RANGE_0_100"))
        self.motors = {"a": mode, "gripper": jaw}
        self.there = {"Present_Position": {"a": 10, "gripper": 60}, "Goal_Position": {"a": 900, "gripper": 0},
                      "Torque_Enable": {"a": 0, "gripper": 0}}
        self.known, self.is_connected, self.fits = known, False, True
        self.said = []

    @property
    def is_calibrated(self):
        assert self.is_connected, "asked before it is there"
        return self.fits

    def connect(self):
        self.is_connected = True

    def disconnect(self, disable_torque=True):
        if disable_torque:
            self.disable_torque()
        self.is_connected = False

    def sync_read(self, name, motors=None, normalize=True, num_retry=0):
        if name not in self.known:
            raise KeyError(name)
        return dict(self.there[name])

    def sync_write(self, name, values, normalize=True, num_retry=0):
        self.there[name].update(values)

    def enable_torque(self, motors=None, num_retry=0):
        self.said.append(("power", dict(self.there["Goal_Position"])))
        self.there["Torque_Enable"] = dict.fromkeys(self.motors, 1)

    def disable_torque(self, motors=None, num_retry=0):
        self.said.append("off")
        self.there["Torque_Enable"] = dict.fromkeys(self.motors, 0)


class Robot:
    name, id = "so_follower", "mine"
    action_features = observation_features = {"a.pos": float, "gripper.pos": float}
    cameras = {}

    def __init__(self, bus, port=""):
        self.bus, self.config = bus, types.SimpleNamespace(disable_torque_on_disconnect=True, port=port)
        self.log = []

    is_calibrated = property(lambda self: self.bus.is_calibrated)

    def connect(self, calibrate=True):
        self.bus.connect()
        self.bus.disable_torque()  # as configure does
        self.bus.enable_torque()

    def get_observation(self):
        return {name + ".pos": float(at) for name, at in self.bus.there["Present_Position"].items()}

    def send_action(self, action):
        self.log.append(action)
        self.bus.there["Goal_Position"] = {name.removesuffix(".pos"): int(at) for name, at in action.items()}

    def disconnect(self):
        self.bus.disconnect(self.config.disable_torque_on_disconnect)


def opened(bus=None):
    arm = lerobot_driver.LeRobotArm(Robot(bus or Bus()))
    arm.open()
    return arm


class LeRobotRules(unittest.TestCase):
    def test_power_finds_no_old_goal(self):
        arm = opened()
        self.assertEqual(arm.lerobot.bus.said[-1], ("power", {"a": 10, "gripper": 60}))
        self.assertEqual([s for s in arm.lerobot.bus.said if s != "off"], [arm.lerobot.bus.said[-1]])

    def test_an_arm_that_is_not_calibrated_gets_no_power_and_keeps_what_it_has(self):
        bus = Bus()
        bus.fits = False
        with self.assertRaisesRegex(SystemExit, "lerobot-calibrate"):
            opened(bus)
        self.assertEqual(bus.said, [])
        self.assertFalse(bus.is_connected)

    def test_a_driver_that_fails_lets_go_of_nothing_and_one_that_ends_does_what_it_says(self):
        arm = opened()
        del arm.lerobot.bus.said[:]
        arm.lerobot.disconnect()  # a destructor
        self.assertEqual(arm.lerobot.bus.said, [])
        arm.close()
        self.assertEqual(arm.lerobot.bus.said, ["off"])

    def test_a_joint_without_power_is_seen_and_limp_fingers_do_not_close_again(self):
        arm = opened()
        self.assertTrue(arm.powered())
        arm.grip, arm.last_target = (1, 0.0, 0.5), [10.0, 0.0]
        arm.lerobot.bus.there["Torque_Enable"]["gripper"] = 0
        arm.ask_again = 0.0
        self.assertFalse(arm.powered())
        arm.enable()
        self.assertEqual(arm.lerobot.log[-1], {"a.pos": 10.0, "gripper.pos": 60.0})
        self.assertTrue(arm.powered())

    def test_an_enable_of_an_arm_with_power_does_not_open_its_gripper(self):
        arm = opened()
        arm.grip = (1, 0.0, 0.5)
        powers = len(arm.lerobot.bus.said)
        arm.enable()
        self.assertEqual(arm.lerobot.log[-1], {"a.pos": 10.0, "gripper.pos": 0.0})
        self.assertEqual(arm.lerobot.bus.there["Goal_Position"]["gripper"], 0)
        self.assertEqual(len(arm.lerobot.bus.said), powers)

    def test_a_bus_without_these_registers_is_driven_as_it_is(self):
        arm = opened(Bus(known=()))
        arm.power_off()
        self.assertFalse(arm.powered())
        arm.enable()
        self.assertTrue(arm.powered())

    def test_a_bus_that_reads_motor_by_motor_is_guarded_too(self):
        class OneByOne(Bus):
            def sync_read(self, name, motors=None, normalize=True, num_retry=0):
                raise NotImplementedError

            sync_write = None

            def read(self, name, motor, normalize=True, num_retry=0):
                return self.there[name][motor]

            def write(self, name, motor, value, normalize=True, num_retry=0):
                self.there[name][motor] = value

        arm = opened(OneByOne())
        self.assertEqual(arm.lerobot.bus.said[-1], ("power", {"a": 10, "gripper": 60}))
        self.assertTrue(arm.powered())

    def test_a_bus_of_another_kind_is_driven_as_it_is_and_left_limp_where_it_is_not_calibrated(self):
        class Can(Bus):
            def sync_read(self, name, motors=None):
                return dict(self.there[name])

        arm = opened(Can())
        self.assertFalse(arm.tells_power)
        self.assertTrue(arm.powered())
        bus = Can()
        bus.fits = False
        with self.assertRaisesRegex(SystemExit, "lerobot-calibrate"):
            opened(bus)
        self.assertEqual(bus.said[-1], "off", "its own connect gave the power")

    def test_a_pair_of_arms_is_asked_and_guarded_arm_by_arm(self):
        class Pair:
            name, id, cameras = "bi_so_follower", "two", {}
            action_features = observation_features = {
                f"{side}_{name}.pos": float for side in ("left", "right") for name in ("a", "gripper")}

            def __init__(self):
                self.config = types.SimpleNamespace()
                self.left_arm, self.right_arm = Robot(Bus()), Robot(Bus())

            is_calibrated = True

            def connect(self, calibrate=True):
                self.left_arm.connect(), self.right_arm.connect()

            def disconnect(self):
                self.left_arm.disconnect(), self.right_arm.disconnect()

            def get_observation(self):
                return {f"{side}_{name}": at for side in ("left", "right")
                        for name, at in getattr(self, side + "_arm").get_observation().items()}

        pair = Pair()
        arm = lerobot_driver.LeRobotArm(pair)
        self.assertEqual(arm.units["right_gripper"], (0, 100))
        self.assertFalse(pair.left_arm.config.disable_torque_on_disconnect)
        arm.open()
        for one in (pair.left_arm, pair.right_arm):
            self.assertEqual(one.bus.said[-1], ("power", {"a": 10, "gripper": 60}))
        self.assertTrue(arm.powered())
        pair.right_arm.bus.there["Torque_Enable"]["a"] = 0
        arm.ask_again = 0.0
        self.assertFalse(arm.powered())
        arm.close()
        self.assertEqual((pair.left_arm.bus.said[-1], pair.right_arm.bus.said[-1]), ("off", "off"))

    def test_a_silent_bus_is_not_asked_for_its_power_and_one_that_answers_once(self):
        tries = []

        class Counting(Bus):
            def sync_read(self, name, motors=None, normalize=True, num_retry=0):
                tries.append((name, num_retry))
                return super().sync_read(name, motors, normalize, num_retry)

        arm = opened(Counting())
        del tries[:]
        arm.look()
        arm.ask_again = 0.0
        arm.powered()
        self.assertEqual(tries, [("Torque_Enable", 0)])
        arm.lerobot.get_observation = lambda: 1 / 0
        with self.assertRaises(ZeroDivisionError):
            arm.look()
        arm.ask_again = 0.0
        self.assertTrue(arm.powered())
        self.assertEqual(len(tries), 1)

    def test_it_says_which_robot_and_in_what_it_counts(self):
        arm = lerobot_driver.LeRobotArm(Robot(Bus()))
        self.assertEqual((arm.robot, arm.units), ("so_follower mine", {"a": "degrees", "gripper": (0, 100)}))

    def test_a_port_that_another_driver_has_is_not_touched(self):
        ours, theirs = os.openpty()
        self.addCleanup(os.close, ours)
        self.addCleanup(os.close, theirs)
        robot = Robot(Bus(), os.ttyname(theirs))
        held = lerobot_driver.claim_port(robot)
        self.addCleanup(os.close, held)
        arm = lerobot_driver.LeRobotArm(robot)
        with self.assertRaisesRegex(SystemExit, "another driver has this arm"):
            arm.open()
        self.assertEqual(arm.lerobot.bus.said, [])

    def test_nothing_is_opened_before_the_socket_is_its_own(self):
        class Counted(bridge.Arm):
            axes, opened, closed = ("a",), 0, 0

            def open(self):
                self.opened += 1
                raise RuntimeError("no answer")

            def close(self):
                self.closed += 1

        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "arm")
            options = types.SimpleNamespace(socket=path, state_hz=100.0, watchdog_s=0.25, on_silence="hold")
            arm = Counted()
            with self.assertRaisesRegex(RuntimeError, "no answer"):
                bridge.serve(arm, options)
            self.assertEqual((arm.opened, arm.closed, os.path.exists(path)), (1, 0, False))
            first = bridge.Session(Counted(), path)
            self.addCleanup(first.listener.close)
            with self.assertRaisesRegex(SystemExit, "a driver listens there already"):
                bridge.serve(arm, options)
            options.state_hz = 1.0
            with self.assertRaisesRegex(SystemExit, "--state-hz"):
                bridge.serve(arm, options)
            self.assertEqual(arm.opened, 1)

    def test_a_robots_destructor_is_not_waited_for(self):
        program = os.path.join(DEPLOY, "robostress_bridge_lerobot.py")
        done = subprocess.run([sys.executable, program, "--socket", "/tmp/none", "--robot-class", "none_such:Robot"],
                              capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 1)
        self.assertIn("none_such", done.stderr)
        done = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=60)
        self.assertEqual(done.returncode, 2)


class Ros2Rules(unittest.TestCase):
    def setUp(self):
        self.node = rclpy.create_node("driver")
        self.addCleanup(self.node.destroy_node)

    def arm(self, other_clock=False):
        return ros2_driver.RosArm(self.node, types.SimpleNamespace(
            simulated=True, joints="a,b", command_topic="/arm/command", state_topic="/joint_states", velocities=False,
            efforts=False, reach_s=0.05, forward=False, other_clock=other_clock))

    def come(self, arm, age_s, a=1.0, stamp=None):
        """How old the driver takes a message to be [s]; None: it took none."""
        message, before = JointState(), arm.newest
        at = stamp if stamp is not None else time.time_ns() - int(age_s * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, 10**9)
        message.name, message.position = ["b", "a"], [2.0, a]
        arm.on_state(message)
        return None if arm.newest is before else (time.monotonic_ns() - arm.newest[0]) / 1e9

    def test_a_state_is_as_old_as_its_stamp_says(self):
        arm = self.arm()
        for age in (40.0, 30.0, 1.5, 1.01, 0.9, 0.2, 0.0):
            self.assertAlmostEqual(self.come(arm, age), age, delta=0.05)
        arm = self.arm()
        self.assertAlmostEqual(self.come(arm, 0.0), 0.0, delta=0.05)
        self.assertIsNone(self.come(arm, 30.0), "older than the one before")

    def test_a_clock_a_little_ahead_is_no_time_to_come_and_one_wild_stamp_is_left_out(self):
        arm = self.arm()
        for age in (0.0, -0.05, -0.4):
            self.assertAlmostEqual(self.come(arm, age), 0.0, delta=0.04)
        arm = self.arm()
        self.come(arm, 0.0)
        self.assertIsNone(self.come(arm, -600.0))
        self.assertAlmostEqual(self.come(arm, 0.0), 0.0, delta=0.05)

    def test_an_old_state_does_not_say_where_the_arm_stands(self):
        arm = self.arm()
        self.come(arm, 30.0)
        self.node.subscriptions.clear()
        with self.assertRaisesRegex(RuntimeError, "not known"):
            arm.hold()

    def test_a_state_that_comes_again_is_none_whatever_the_clock(self):
        for other in (False, True):
            arm, stamp = self.arm(other), time.time_ns()
            self.assertIsNotNone(self.come(arm, 0, 1.0, stamp))
            self.assertIsNone(self.come(arm, 0, 2.0, stamp))
            self.assertEqual(arm.newest[1][0], 1.0)

    def test_states_of_another_clock_count_from_when_they_come(self):
        arm = self.arm()
        for age in (1e8, 1e8 - 1):  # a simulation's
            self.assertAlmostEqual(self.come(arm, age), 0.0, delta=0.05)
        self.assertAlmostEqual(self.come(self.arm(other_clock=True), 30.0), 0.0, delta=0.05)
        self.assertAlmostEqual(self.come(self.arm(), 0, stamp=0), 0.0, delta=0.05)

    def test_nothing_is_obeyed_while_nobody_listens(self):
        arm = self.arm()
        self.come(arm, 0.0)
        with tempfile.NamedTemporaryFile() as file:
            os.environ["STAND_IN_NOBODY_LISTENS"] = file.name
            self.addCleanup(os.environ.pop, "STAND_IN_NOBODY_LISTENS")
            with self.assertRaisesRegex(RuntimeError, "nobody listens to /arm/command"):
                arm.hold()


if __name__ == "__main__":
    unittest.main()
