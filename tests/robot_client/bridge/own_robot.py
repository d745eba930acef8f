"""A Robot of LeRobot's own base class that nobody registered: --robot-class own_robot:OwnRobot.

Its actions have an axis more than a client drives, and it measures velocities.
"""

import json
import time
from dataclasses import dataclass

from lerobot.robots import Robot, RobotConfig

AXES = ["a", "lift", "b", "jaw"]


@RobotConfig.register_subclass("own_robot")
@dataclass
class OwnConfig(RobotConfig):
    speed: float = 1.0
    log: str = ""


class OwnRobot(Robot):
    config_class, name = OwnConfig, "own_robot"

    def __init__(self, config):
        super().__init__(config)
        self.config, self.connected = config, False
        self.at = dict(zip(AXES, [10.0, 55.0, -20.0, 30.0]))
        self.target, self.moved = dict(self.at), time.monotonic()

    observation_features = {f"{n}.{k}": float for n in AXES for k in ("pos", "vel")}
    action_features = {f"{n}.pos": float for n in AXES}
    is_connected = property(lambda self: self.connected)
    is_calibrated = True

    def connect(self, calibrate=True):
        self.connected = True

    def calibrate(self):
        raise AssertionError("nobody asked for it")

    def configure(self):
        pass

    def get_observation(self):
        now = time.monotonic()
        step, self.moved = 60 * self.config.speed * (now - self.moved), now
        seen = {}
        for name in AXES:
            gap = max(-step, min(step, self.target[name] - self.at[name]))
            self.at[name] += gap
            seen[f"{name}.pos"] = self.at[name]
            seen[f"{name}.vel"] = 0.0 if gap == 0 else 60 * self.config.speed * (1 if gap > 0 else -1)
        return seen

    def send_action(self, action):
        assert sorted(action) == sorted(self.action_features), action
        self.target = {name: action[f"{name}.pos"] for name in AXES}
        if self.config.log:
            with open(self.config.log, "a") as file:
                file.write(json.dumps(self.target) + "\n")
        return action

    def disconnect(self):
        self.connected = False
