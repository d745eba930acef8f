"""Joint errors in robosuite's environments, between the controller's torques and the physics."""
from __future__ import annotations

from typing import Any, List, Optional, Set, Tuple

import numpy as np

from robostress._library import InvalidArgument
from robostress.joint_errors import JointErrors


class _Arm:
    """What MuJoCo knows of an arm's joints."""

    def __init__(self, sim: Any, robot: Any, errors: JointErrors) -> None:
        self.model, self.data = sim.model._model, sim.data._data
        m, d = self.model, self.data
        self.qpos, self.dof = list(robot._ref_joint_pos_indexes), list(robot._ref_joint_vel_indexes)
        self.joint, motor = list(robot._ref_joint_indexes), list(robot._ref_joint_actuator_indexes)
        if not np.all(m.actuator_gear[motor, 0] == 1):
            raise InvalidArgument(f"the gears of {robot.name}'s motors are {m.actuator_gear[motor, 0]}, must be 1: the errors "
                                  "bend joint torques")
        self.body = m.jnt_bodyid[self.joint]
        self.site = sim.model.site_name2id(robot.gripper.important_sites["grip_site"])
        # act() reads q, dq and gravity itself.
        self.fields = [(getattr(self, name), getattr(errors, name))
                       for name in sorted(errors.reads - {"q", "dq", "gravity"})]
        errors.attach(m.opt.gravity, qpos=d.qpos, qvel=d.qvel, ctrl=d.ctrl, xaxis=d.xaxis, xanchor=d.xanchor,
                      subtree_com=d.subtree_com, subtree_mass=m.body_subtreemass, qpos_index=self.qpos,
                      dof_index=self.dof, ctrl_index=motor, joint_index=self.joint, body_index=self.body)

    def look(self) -> None:
        """Fills what the errors read beside q, dq and gravity."""
        for read, field in self.fields:
            field[:] = read()

    def q(self) -> np.ndarray:
        return self.data.qpos[self.qpos]

    def dq(self) -> np.ndarray:
        return self.data.qvel[self.dof]

    def gravity(self, field: Optional[np.ndarray] = None) -> np.ndarray:
        """Torques that hold the arm against gravity, or against another field [m/s^2]."""
        lever = self.data.subtree_com[self.body] - self.data.xanchor[self.joint]
        moment = np.cross(lever, self.model.opt.gravity if field is None else field)
        return -self.model.body_subtreemass[self.body] * (moment * self.data.xaxis[self.joint]).sum(axis=1)

    def _column(self) -> np.ndarray:
        return np.cross(self.data.xaxis[self.joint], self.data.site_xpos[self.site] - self.data.xanchor[self.joint])

    def payload_gravity(self) -> np.ndarray:
        return -self._column() @ self.model.opt.gravity

    def payload_inertia(self) -> np.ndarray:
        return (self._column()**2).sum(axis=1)

    def tilt_gravity(self) -> np.ndarray:
        return np.stack([self.gravity(-np.cross(axis, self.model.opt.gravity)) for axis in np.eye(3)[:2]], axis=1)

    def mass_matrix(self) -> np.ndarray:
        import mujoco  # type: ignore[import-not-found]
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, full, self.data.qM)
        return full[np.ix_(self.dof, self.dof)]

    def other_torque(self) -> np.ndarray:
        d = self.data
        return d.qfrc_passive[self.dof] - d.qfrc_bias[self.dof] + d.qfrc_constraint[self.dof]

    def ddq(self) -> np.ndarray:
        return self.data.qacc[self.dof]


class WrappedEnvironment:
    """The environment with joint errors: step() and reset() as its own, everything else is its own. step() adds to `info`
    under "robostress": `commanded`, the action; `asked` and `applied` [sub-steps, joints], torques of the controller and at
    the joints; `q`, `dq`, measured after the step; `held`.
    """

    def __init__(self, env: Any, errors: JointErrors, robot: int, settle_steps: int, watches_grasp: bool) -> None:
        self.env, self.errors = env, errors
        base = env
        while not hasattr(base, "_pre_action"):
            base = base.env
        self._base, self._robot, self._settle_steps, self._watches_grasp = base, robot, settle_steps, watches_grasp
        self._original, self._sim, self._steps, self._held = base._pre_action, None, 0, False
        self._asked: list = []
        self._applied: list = []
        self._begun = False
        base._pre_action = self._pre_action

    def __getattr__(self, name: str) -> Any:
        return getattr(self.env, name)

    def reset(self, *arguments: Any, **more: Any) -> Any:
        self._begun = False
        return self.env.reset(*arguments, **more)

    def set_init_state(self, *arguments: Any, **more: Any) -> Any:
        self._begun = False
        return self.env.set_init_state(*arguments, **more)

    def step(self, action: Any) -> Tuple:
        result = self.env.step(action)
        result[-1]["robostress"] = {"commanded": np.array(action), "asked": np.array(self._asked),
                                    "applied": np.array(self._applied), "q": self._arm.q(), "dq": self._arm.dq(),
                                    "held": self._held}
        return result

    def unwrap(self) -> Any:
        """The environment as it was."""
        self._base._pre_action = self._original
        return self.env

    def _begin(self) -> None:
        """At the first torques of an episode, whatever set its state before."""
        robot = self._base.robots[self._robot]
        self._arm = arm = _Arm(self._base.sim, robot, self.errors)
        self._controller = robot.controller
        self._pads: List[List[int]] = [[self._base.sim.model.geom_name2id(name) for name in robot.gripper.important_geoms[pad]]
                      for pad in ("left_fingerpad", "right_fingerpad")] if self._watches_grasp else []
        elsewhere = arm.q() + 0.0123
        if not np.array_equal(self.errors.reading(elsewhere, arm.dq())[0], elsewhere):
            raise InvalidArgument("the scenario bends what encoders read, and robosuite's controller takes positions from "
                                  "the simulator: leave out its effects of stage sensor")
        arm.look()
        low, high = robot.torque_limits
        self.errors.reset(arm.q(), step=float(arm.model.opt.timestep), holding=arm.gravity(), gravity=arm.gravity(),
                          torque_low=low, torque_high=high)
        self._sim, self._steps, self._begun = self._base.sim, 0, True

    def _pre_action(self, action: Any, policy_step: bool = False) -> None:
        self._original(action, policy_step)
        if policy_step:
            self._begin_control_step()
        if self._arm.fields:
            self._arm.look()
        asked = self._controller.torques
        self._asked.append(asked)
        self._applied.append(self.errors.act(asked).copy())

    def _begin_control_step(self) -> None:
        if not self._begun or self._base.sim is not self._sim:
            self._begin()
        self._held = self._watches_grasp and self._grasps()
        self.errors.begin_control_step(max(0, self._steps - self._settle_steps), self._held)
        self._steps += 1
        self._asked, self._applied = [], []

    def _grasps(self) -> bool:
        """Whether both finger pads touch one and the same free body."""
        m, d = self._arm.model, self._arm.data
        geoms = np.array([d.contact.geom1[:d.ncon], d.contact.geom2[:d.ncon]])
        sides: List[Set[int]] = []
        for pads in self._pads:
            touched = geoms[::-1][np.isin(geoms, pads)]
            roots = m.body_rootid[m.geom_bodyid[touched]]
            sides.append({int(root) for root in roots
                          if m.body_jntnum[root] > 0 and m.jnt_type[m.body_jntadr[root]] == 0})
        return bool(sides[0] & sides[1])


def wrap(env: Any, scenario: str, *, severity: int = 5, seed: int = 0, horizon: int = 0, settle_steps: int = 0,
         robot: int = 0, **options: Any) -> WrappedEnvironment:
    """An environment of robosuite 1.4, or one around it such as LIBERO's OffScreenRenderEnv, with the errors of a scenario
    in an arm's joints. horizon: control steps over which severities that grow do so; 0: the environment's. settle_steps:
    of an episode that do not count for them. options: as of JointErrors.
    """
    base = env
    while not hasattr(base, "_pre_action"):
        base = getattr(base, "env", None)
        if base is None:
            raise InvalidArgument(f"{type(env).__name__} is no environment of robosuite 1.4: nothing in it has _pre_action")
    robots = getattr(base, "robots", [])
    if not 0 <= robot < len(robots):
        raise InvalidArgument(f"robot is {robot}, must be 0 to {len(robots) - 1}")
    if not hasattr(robots[robot], "controller") or isinstance(robots[robot].controller, dict):
        raise InvalidArgument(f"robot {robot} has no single controller: robosuite 1.4's single arms can be wrapped")
    errors = JointErrors(scenario, len(robots[robot].robot_joints), severity, seed, horizon=horizon or int(base.horizon),
                         **options)
    # The grasp gate is heavy_payload's; what a file is based on is not known here.
    return WrappedEnvironment(env, errors, robot, settle_steps, scenario == "heavy_payload" or scenario.endswith(".yaml"))
