#!/usr/bin/env python3
"""Gives an arm of LeRobot to robot_client, from the environment that LeRobot runs in.

    python robostress_bridge_lerobot.py --socket /tmp/arm --robot.type=so101_follower \\
      --robot.port=/dev/ttyACM0 --robot.id=my_arm --robot.use_degrees=true
    robot_client --arm bridge:unix:/tmp/arm --robot so101.yaml ...

Any class of `lerobot.robots.Robot` will do, LeRobot's own and plug-ins, by --robot.type, or by
--robot-class package.module:Class; --robot.KEY=VALUE are the fields of its configuration, as
LeRobot's own programs take them. The class and robostress_bridge.py, which lies beside this file,
are all that is needed.

What travels are the actions that end in `.pos`, by their names without it, in the robot's own units
(degrees, -100..100, 0..100, radians: the robot file of robot_client says which). An action of the
robot that the client does not name keeps its place when --keep names it.

A LeRobot robot has no stop and no hold of its own: both send it where it stands, once, and its
gripper where it was last told. The power is taken off where its bus has `disable_torque`. Some robots
switch the power off and on when they connect, and off when they disconnect: support the arm when
this program begins and ends. Where the bus has the registers, no motor gets power while its goal is
not where it stands, joints whose torque is off are reported as without power, and a serial port that
another driver has is not touched.
"""

import argparse
import fcntl
import inspect
import logging
import os
import stat
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import robostress_bridge as bridge

POSITION, VELOCITY = ".pos", ".vel"
UNITS = {"DEGREES": "degrees", "RADIANS": "radians", "RANGE_M100_100": (-100, 100), "RANGE_0_100": (0, 100)}
POWER_S = 0.2  # so often motors are asked whether they have power
RETRIES = 5  # of what must not be lost


def make_robot(options, fields):
    """The Robot, not connected. `fields`: --robot.KEY=VALUE."""
    if options.robot_class:
        module, _, name = options.robot_class.partition(":")
        __import__(module)
        robot_class = getattr(sys.modules[module], name)
        import draccus

        arguments = [field.replace("--robot.", "--", 1) for field in fields]
        return robot_class(draccus.parse(config_class=robot_class.config_class, args=arguments))
    import importlib
    import pkgutil
    from dataclasses import make_dataclass

    import draccus
    import lerobot.robots as robots

    for module in pkgutil.iter_modules(robots.__path__):
        try:  # registers its configuration; many want libraries of their own
            importlib.import_module(f"lerobot.robots.{module.name}")
        except ImportError as error:
            logging.debug("lerobot.robots.%s: %s", module.name, error)
    try:
        from lerobot.utils.import_utils import register_third_party_plugins as plugins
    except ImportError:  # LeRobot before 0.4.2
        from lerobot.utils.import_utils import register_third_party_devices as plugins
    plugins()
    line = make_dataclass("Line", [("robot", robots.RobotConfig)])
    return robots.make_robot_from_config(draccus.parse(config_class=line, args=fields).robot)


def claim_port(robot):
    """A serial port that another driver has is refused before a byte goes out. Kept until the end."""
    port = str(getattr(robot.config, "port", None) or "")
    try:
        is_device = stat.S_ISCHR(os.stat(port).st_mode)
    except OSError:
        return None
    if not is_device:
        return None
    held = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(held)
        raise SystemExit(f"{port}: another driver has this arm; end it first") from error
    return held


def parts_of(robot):
    """[(what its actions' names begin with, a robot with a bus)]: itself, or the two arms of a pair."""
    if getattr(robot, "bus", None) is not None:
        return [("", robot)]
    return [(name.removesuffix("arm"), part) for name, part in vars(robot).items()
            if getattr(part, "bus", None) is not None and hasattr(part, "config")]


class Motors:
    """The registers of a bus, in the motors' own counts. `known`: it has them, and can be asked before it gives power."""

    def __init__(self, bus):
        self.bus = bus
        has = all(hasattr(type(bus), n) for n in ("connect", "disconnect", "is_calibrated", "sync_read", "sync_write"))
        self.known = has and "normalize" in inspect.signature(type(bus).sync_read).parameters
        self.one_by_one = False

    def read(self, name, retries=RETRIES):
        if not self.one_by_one:
            try:
                return self.bus.sync_read(name, normalize=False, num_retry=retries)
            except NotImplementedError:  # Feetech's protocol 1
                self.one_by_one = True
        return {motor: self.bus.read(name, motor, normalize=False, num_retry=retries) for motor in self.bus.motors}

    def write(self, name, values):
        if not self.one_by_one:
            self.bus.sync_write(name, values, normalize=False, num_retry=RETRIES)
            return
        for motor, value in values.items():
            self.bus.write(name, motor, value, normalize=False, num_retry=RETRIES)

    def guard_power(self):
        """From now on no motor gets power while its goal is an old one."""
        give_power = self.bus.enable_torque

        def guarded(motors=None, *arguments, **options):
            self.write("Goal_Position", self.read("Present_Position"))
            return give_power(motors, *arguments, **options)

        self.bus.enable_torque = guarded


def calibrated(robot):
    """Asked of the motors, whose bus may lose an answer."""
    for _ in range(2):
        try:
            return robot.is_calibrated
        except ConnectionError as error:
            logging.warning("asked again: %s", error)
    return robot.is_calibrated


def expect_calibrated(robot):
    if not calibrated(robot):
        raise SystemExit(f"{robot.name} is not calibrated: run lerobot-calibrate with the same --robot options first")


class LeRobotArm(bridge.Arm):
    """A lerobot Robot, which `open` connects."""

    driver = "robostress_bridge_lerobot"

    def __init__(self, robot, keep=(), velocities=False, simulated=False):
        self.lerobot, self.simulated = robot, simulated
        self.robot = " ".join(filter(None, [robot.name, getattr(robot, "id", None)]))
        actions = [name.removesuffix(POSITION) for name in robot.action_features if name.endswith(POSITION)]
        unknown = [name for name in keep if name not in actions]
        if unknown or not actions:
            raise SystemExit(f"--keep {unknown}: this robot has {actions}")
        self.axes = [name for name in actions if name not in keep]
        self.kept = {name: None for name in keep}
        self.measures_velocity = velocities
        missing = [n for n in self.axes if velocities and n + VELOCITY not in robot.observation_features]
        if missing:
            raise SystemExit(f"--velocities: {robot.name} measures none of {missing}")
        self.parts = parts_of(robot)
        self.motors = [Motors(part.bus) for _, part in self.parts]
        self.can_power_off = bool(self.parts) and all(
            hasattr(m.bus, "disable_torque") and hasattr(m.bus, "enable_torque") for m in self.motors)
        self.on, self.ask_again, self.tells_power, self.answered, self.ports = True, 0.0, False, True, []
        self.units = {}
        for prefix, part in self.parts:
            for name, motor in (getattr(part.bus, "motors", None) or {}).items():
                mode = getattr(getattr(motor, "norm_mode", None), "name", "")
                if prefix + name in self.axes and mode in UNITS:
                    self.units[prefix + name] = UNITS[mode]
        # Until `close`: a driver that fails, or is refused, must not let go of an arm that holds.
        configs = [robot.config, *(part.config for _, part in self.parts)]
        self.off_at_end = [c for c in configs if getattr(c, "disable_torque_on_disconnect", None)]
        off = bool(self.off_at_end)
        if not any(hasattr(c, "disable_torque_on_disconnect") for c in configs):
            off = None
        for config in self.off_at_end:
            config.disable_torque_on_disconnect = False
        notes = []
        if off:
            notes.append("when this driver ends the power goes off and the arm FALLS "
                         "(--robot.disable_torque_on_disconnect=false keeps it)")
        elif off is None:
            notes.append("what the arm does when this driver ends is not known")
        if getattr(robot, "cameras", None):
            notes.append("the robot's cameras are read with every state, which makes states late: "
                         "leave them out, robot_client has its own")
        self.note = "; ".join(notes)

    def open(self):
        self.ports = [claim_port(part) for _, part in self.parts or [("", self.lerobot)]]
        self.tells_power = bool(self.parts)
        for (_, part), motors in zip(self.parts, self.motors):
            if not motors.known:
                self.tells_power = False
                continue
            part.bus.connect()  # alone: the robot's own connect gives power
            try:
                expect_calibrated(part)
                motors.read("Torque_Enable")
                motors.guard_power()
            except KeyError as error:
                logging.warning("%s: whether its motors have power is not known: no %s", part.name, error)
                self.tells_power = False
            finally:
                part.bus.disconnect(disable_torque=False)
        self.lerobot.connect(calibrate=False)
        try:
            expect_calibrated(self.lerobot)
        except SystemExit:  # of a robot that could not be asked before: the power is of this connect
            self.close()
            raise

    def read(self):
        before = time.monotonic_ns()
        self.answered = False
        seen = self.lerobot.get_observation()
        self.answered = True
        self.kept = {n: seen[n + POSITION] if at is None else at for n, at in self.kept.items()}
        position = [float(seen[name + POSITION]) for name in self.axes]
        velocity = [float(seen[n + VELOCITY]) for n in self.axes] if self.measures_velocity else None
        return before, position, velocity, None, 0  # no younger than it is: before the bus was asked

    def move(self, targets, gripper_effort):
        action = {name + POSITION: float(at) for name, at in self.kept.items()}
        action.update({name + POSITION: target for name, target in zip(self.axes, targets)})
        self.lerobot.send_action(action)

    def enable(self):
        self.kept = dict.fromkeys(self.kept)
        self.ask_again = 0.0
        had_power = self.powered()
        if not had_power:
            self.grip = self.last_target = None  # limp fingers may have something between them
        self.hold()  # first, so that power finds no old target
        if self.can_power_off and not (had_power and self.tells_power):
            for motors in self.motors:
                motors.bus.enable_torque()
        self.on, self.ask_again = True, 0.0

    def power_off(self):
        for motors in self.motors:
            motors.bus.disable_torque()
        self.on = False

    def powered(self):
        now = time.monotonic()
        # Once, and not of a bus that has just been silent: every try holds up the loop.
        if self.tells_power and self.answered and now >= self.ask_again:
            self.ask_again = now + POWER_S
            try:
                self.on = all(all(motors.read("Torque_Enable", retries=0).values()) for motors in self.motors)
            except ConnectionError as error:  # read says so too, if it lasts
                logging.debug("asked again: %s", error)
        return self.on

    def close(self):
        for config in self.off_at_end:
            config.disable_torque_on_disconnect = True
        self.lerobot.disconnect()


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    bridge.add_options(parser)
    parser.add_argument("--robot-class", help="package.module:Class instead of --robot.type")
    parser.add_argument("--keep", action="append", default=[], metavar="NAME",
                        help="an action of the robot that the client does not drive; repeatable")
    parser.add_argument("--velocities", action="store_true",
                        help="the observations ending in .vel are velocities, in units of .pos a second")
    parser.add_argument("--simulated", action="store_true", help="nobody can be hurt by this robot")
    options, fields = parser.parse_known_args(arguments)
    wrong = [field for field in fields if not field.startswith("--robot.") or "=" not in field]
    if wrong:
        parser.error(f"{wrong[0]}: LeRobot's options are written --robot.KEY=VALUE")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    bridge.serve(LeRobotArm(make_robot(options, fields), options.keep, options.velocities, options.simulated), options)


if __name__ == "__main__":
    try:
        main()
    except BaseException as error:  # whatever ends it, a robot's destructor would take the power off
        if isinstance(error, SystemExit) and isinstance(error.code, str):
            print(error.code, file=sys.stderr)
        elif not isinstance(error, SystemExit):
            logging.exception("this driver ends; the arm is left as it is")
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(error.code if isinstance(error, SystemExit) and isinstance(error.code, int) else 1)
