#!/usr/bin/env python3
"""Gives an arm of LeRobot to robot_client, from the environment that LeRobot runs in.

    python robostress_bridge_lerobot.py --socket /tmp/arm --robot.type=so101_follower \\
      --robot.port=/dev/ttyACM0 --robot.id=my_arm
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
this program begins and ends.
"""

import argparse
import logging
import os
import sys
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import robostress_bridge as bridge

POSITION, VELOCITY = ".pos", ".vel"


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


def calibrated(robot):
    """Asked of the motors, whose bus may lose an answer."""
    for _ in range(2):
        try:
            return robot.is_calibrated
        except ConnectionError as error:
            logging.warning("asked again: %s", error)
    return robot.is_calibrated


class LeRobotArm(bridge.Arm):
    """A lerobot Robot, connected."""

    driver = "robostress_bridge_lerobot"

    def __init__(self, robot, keep=(), velocities=False, simulated=False):
        self.lerobot, self.simulated, self.robot = robot, simulated, robot.name
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
        bus = getattr(robot, "bus", None)
        self.can_power_off = hasattr(bus, "disable_torque") and hasattr(bus, "enable_torque")
        self.on = True
        off = getattr(robot.config, "disable_torque_on_disconnect", None)
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

    def read(self):
        before = time.monotonic_ns()
        seen = self.lerobot.get_observation()
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
        self.hold()  # first, so that power finds no old target
        if self.can_power_off:
            self.lerobot.bus.enable_torque()
        self.on = True

    def power_off(self):
        self.lerobot.bus.disable_torque()
        self.on = False

    def powered(self):
        return self.on

    def close(self):
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
    robot = make_robot(options, fields)
    arm = LeRobotArm(robot, options.keep, options.velocities, options.simulated)
    robot.connect(calibrate=False)
    if not calibrated(robot):
        robot.disconnect()
        raise SystemExit(f"{robot.name} is not calibrated: run lerobot-calibrate with the same --robot options first")
    bridge.serve(arm, options)


if __name__ == "__main__":
    main()
