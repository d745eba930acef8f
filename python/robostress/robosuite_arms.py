"""Wrapped arms of robosuite's environments, 1.4 and 1.5, and of what is built on them."""
from __future__ import annotations

import functools
import sys
from typing import Any, Callable, Dict, List, Optional, Tuple

from robostress._library import InvalidArgument, integer
from robostress.joint_errors import JointErrors
from robostress.mujoco_arm import ArmEpisode, Hooked, MujocoArm, put_back

Key = Tuple[int, str]


def base_of(env: Any) -> Optional[Any]:
    """The environment of robosuite in `env`, or None."""
    kind = getattr(sys.modules.get("robosuite.environments.base"), "MujocoEnv", ())
    while env is not None and not isinstance(env, kind):
        inside = vars(env) if hasattr(env, "__dict__") else {}
        env = inside.get("_wrapped", inside.get("env"))
    return env


class _Robot:
    """One arm of a robot: 1.5 has parts; 1.4 one controller, or of two arms one each, the right one's joints first."""

    def __init__(self, robot: Any, arm: str) -> None:
        if hasattr(robot, "composite_controller"):
            self.robot, arms = robot, list(robot.arms)
            if arm not in arms:
                raise InvalidArgument(f"arm is '{arm}', robot {robot.name} has {arms}")
            self.controller: Callable[[], Any] = lambda: robot.part_controllers[arm]
            self.joints = lambda: robot._ref_joints_indexes_dict[arm]
            self.motors = lambda: robot._ref_actuators_indexes_dict[arm]
            self.gripper = lambda: robot.gripper[arm]
            self.count = len(robot.robot_model.arm_joints) // len(arms)
            return
        both = isinstance(robot.controller, dict)
        arms = list(robot.arms) if both else ["right"]
        if arm not in arms:
            raise InvalidArgument(f"arm is '{arm}', robot {robot.name} has {arms}")
        split = robot._joint_split_idx if both else None
        part = slice(split, None) if arm == "left" else slice(split)
        self.controller = lambda: robot.controller[arm] if both else robot.controller
        self.joints = lambda: robot._ref_joint_indexes[part]
        self.motors = lambda: robot._ref_joint_actuator_indexes[part]
        self.gripper = lambda: robot.gripper[arm] if both else robot.gripper
        self.count = len(robot.robot_joints[part])


def _of_mujoco(sim: Any, name: str) -> Optional[Callable[..., Any]]:
    """MuJoCo's function behind the simulator's own sub-step, where nobody has put another one in its place."""
    method = getattr(type(sim), name)
    if name in vars(sim) or getattr(method, "__globals__", {}).get("__name__") != "robosuite.utils.binding_utils":
        return None
    return getattr(sys.modules["mujoco"], f"mj_{name}")


class RobosuiteArms(Hooked):
    """All wrapped arms of one environment: its step() puts them between its controllers and the physics."""

    def __init__(self, base: Any) -> None:
        self.base, self.sim = base, None
        self._parts: List[Any] = []  # what _made was made of, and its ids
        self._kept: List[int] = []
        self._made: Callable[..., Any]
        self.episodes: Dict[Key, ArmEpisode] = {}
        self.robots: Dict[Key, _Robot] = {}
        self._step, self._replaced = base.step, vars(base).get("step")
        base.step, base._robostress = self.step, self

    @staticmethod
    def joints(base: Any, robot: int, arm: str) -> Tuple[int, bool]:
        """How many the arm has, and whether it is a Panda's."""
        found = base.robots[integer("robot", robot, 0, len(base.robots) - 1)]
        return _Robot(found, arm).count, "Panda" in type(found.robot_model).__name__

    def add(self, key: Key, errors: JointErrors, settle_steps: int) -> ArmEpisode:
        name = "robostress" if key == (0, "right") else f"robostress_{key[0]}_{key[1]}"
        episode = ArmEpisode(name, errors, settle_steps, lambda: self._arm(key, errors))
        self.episodes[key] = episode
        return episode

    def remove(self, key: Key, episode: ArmEpisode) -> None:
        if self.episodes.get(key) is not episode:  # removed already; another one may have come since
            return
        del self.episodes[key]
        if not self.episodes and vars(self.base).get("_robostress") is self:
            put_back(self.base, "step", self._replaced)
            del self.base._robostress

    def _arm(self, key: Key, errors: JointErrors) -> MujocoArm:
        # A hard reset makes robots anew.
        self.robots[key] = robot = _Robot(self.base.robots[key[0]], key[1])
        sim, gripper = self.base.sim, robot.gripper()
        geoms = gripper.important_geoms
        pads: List[List[int]] = [[sim.model.geom_name2id(name) for name in geoms[side]]
                                 for side in ("left_fingerpad", "right_fingerpad") if geoms.get(side)]
        return MujocoArm(sim.model._model, sim.data._data, robot.joints(), robot.motors(), errors,
                         tool=sim.model.site_name2id(gripper.important_sites["grip_site"]), pads=pads,
                         rows=int(self.base.control_timestep / self.base.model_timestep))

    def step(self, action: Any) -> Any:
        base, sim = self.base, self.base.sim
        if base.timestep == 0 or sim is not self.sim:
            for episode in self.episodes.values():
                episode.begun = False
        self.sim = sim
        name = "step2" if getattr(base, "lite_physics", False) else "step"
        replaced, physics, of_mujoco = vars(sim).get(name), getattr(sim, name), _of_mujoco(sim, name)

        def first(*_: Any) -> None:
            sub_step = self._sub_step([sim.model._model, sim.data._data, getattr(type(sim), name), replaced, of_mujoco], physics)
            setattr(sim, name, sub_step)
            sub_step()

        setattr(sim, name, first)
        try:
            result = self._step(action)
        finally:
            put_back(sim, name, replaced)
        for episode in self.episodes.values():
            result[-1][episode.name] = episode.executed(action)
        return result

    def _sub_step(self, parts: List[Any], physics: Callable[..., Any]) -> Callable[..., Any]:
        """Of the control step that begins: physics(), or without the way through robosuite MuJoCo's function. parts: model, data,
        what the simulator has, MuJoCo's function; the last one's sub-step serves while they and the arms are the same."""
        count, (model, data, *_, of_mujoco) = len(parts), parts
        for key, episode in self.episodes.items():
            parts += episode.begin_control_step(), self.robots[key].controller()
        kept = [*map(id, parts)]
        if kept != self._kept:
            sub_step = physics if of_mujoco is None else functools.partial(of_mujoco, model, data)
            for k in range(len(parts) - 2, count - 1, -2):
                sub_step = parts[k].sub_step(parts[k + 1], sub_step)
            self._made, self._parts, self._kept = sub_step, parts, kept
        return self._made
