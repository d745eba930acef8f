"""Joint errors in robosuite's environments, between the controller's torques and the physics."""
from __future__ import annotations

from typing import Any, Tuple

import numpy as np

from robostress._library import InvalidArgument
from robostress.joint_errors import JointErrors


def _rows(array: np.ndarray, indices: Any) -> Tuple[np.ndarray, bool]:
    """These rows of a simulator's array: a view where they follow each other, as an arm's joints mostly do."""
    first, last = indices[0], indices[-1] + 1
    if list(indices) == list(range(first, last)):
        return array[first:last], True
    return array[np.array(indices)], False


class _Arm:
    """What MuJoCo knows of an arm's joints. fields: what fills each array that the errors read, q and dq included."""

    def __init__(self, sim: Any, robot: Any, errors: JointErrors) -> None:
        self.model, self.data = sim.model._model, sim.data._data
        self.qpos, self.dof = list(robot._ref_joint_pos_indexes), list(robot._ref_joint_vel_indexes)
        self.motor, self.joint = list(robot._ref_joint_actuator_indexes), list(robot._ref_joint_indexes)
        if not np.all(self.model.actuator_gear[self.motor, 0] == 1):
            raise InvalidArgument(f"the gears of {robot.name}'s motors are {self.model.actuator_gear[self.motor, 0]}, must "
                                  "be 1: the errors bend joint torques")
        self.body = self.model.jnt_bodyid[self.joint]
        self.site = sim.model.site_name2id(robot.gripper.important_sites["grip_site"])
        self.minus_mass = -self.model.body_subtreemass[self.body]
        gravity = self.model.opt.gravity
        self.turn = self._turn(gravity)
        self.tilts = [self._turn(-np.cross(axis, gravity)) for axis in np.eye(3)[:2]]
        self.lever, self.torque, self.ones = np.empty((len(self.joint), 3)), np.empty((len(self.joint), 3)), np.ones(3)
        self.poses = [_rows(array, indices) for array, indices in (
            (self.data.subtree_com, self.body), (self.data.xanchor, self.joint), (self.data.xaxis, self.joint))]
        self.poses_are_views = all(view for _, view in self.poses)
        self.q, q_is_view = _rows(self.data.qpos, self.qpos)
        self.dq, dq_is_view = _rows(self.data.qvel, self.dof)
        self.ctrl, ctrl_is_view = _rows(self.data.ctrl, self.motor)
        self.are_views = q_is_view and dq_is_view and ctrl_is_view
        self.fields = [(getattr(self, name), name) for name in sorted(errors.reads - {"q", "dq"})]
        errors.bind(q=self.q, dq=self.dq)

    @staticmethod
    def _turn(field: np.ndarray) -> np.ndarray:
        """r @ _turn(g) = r x g."""
        x, y, z = field
        return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])

    def look(self, errors: JointErrors) -> None:
        """Fills what the errors read."""
        if not self.are_views:
            self.q[:], self.dq[:] = self.data.qpos[self.qpos], self.data.qvel[self.dof]
        if not self.poses_are_views:
            self.poses = [(array[indices], False) for array, indices in (
                (self.data.subtree_com, self.body), (self.data.xanchor, self.joint), (self.data.xaxis, self.joint))]
        for fill, name in self.fields:
            fill(getattr(errors, name))

    def act(self, applied: np.ndarray, change: np.ndarray) -> None:
        if self.are_views:
            self.ctrl[:] = applied
            np.add(self.q, change, out=self.q)
        else:
            self.data.ctrl[self.motor] = applied
            self.data.qpos[self.qpos] += change

    def _hold(self, turn: np.ndarray, out: np.ndarray) -> None:
        (com, _), (anchor, _), (axis, _) = self.poses
        np.subtract(com, anchor, out=self.lever)
        np.dot(self.lever, turn, out=self.torque)
        np.multiply(self.torque, axis, out=self.torque)
        np.multiply(self.torque.dot(self.ones), self.minus_mass, out=out)

    def gravity(self, out: np.ndarray) -> None:
        self._hold(self.turn, out)

    def _column(self) -> np.ndarray:
        (_, _), (anchor, _), (axis, _) = self.poses
        return np.cross(axis, self.data.site_xpos[self.site] - anchor)

    def payload_gravity(self, out: np.ndarray) -> None:
        out[:] = -self._column() @ self.model.opt.gravity

    def payload_inertia(self, out: np.ndarray) -> None:
        out[:] = (self._column()**2).sum(axis=1)

    def tilt_gravity(self, out: np.ndarray) -> None:
        for i, turn in enumerate(self.tilts):
            torque = np.empty(len(out))
            self._hold(turn, torque)
            out[:, i] = torque

    def mass_matrix(self, out: np.ndarray) -> None:
        import mujoco
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, full, self.data.qM)
        out[:] = full[np.ix_(self.dof, self.dof)]

    def other_torque(self, out: np.ndarray) -> None:
        d = self.data
        out[:] = d.qfrc_passive[self.dof] - d.qfrc_bias[self.dof] + d.qfrc_constraint[self.dof]

    def ddq(self, out: np.ndarray) -> None:
        out[:] = self.data.qacc[self.dof]


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
                                    "applied": np.array(self._applied), "q": self._arm.q.copy(), "dq": self._arm.dq.copy(),
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
        self._pads = [[self._base.sim.model.geom_name2id(name) for name in robot.gripper.important_geoms[pad]]
                      for pad in ("left_fingerpad", "right_fingerpad")] if self._watches_grasp else None
        reading, _ = self.errors.reading(arm.q + 0.0123, arm.dq)
        if not np.array_equal(reading, arm.q + 0.0123):
            raise InvalidArgument("the scenario bends what encoders read, and robosuite's controller takes positions from "
                                  "the simulator: leave out its effects of stage sensor")
        arm.look(self.errors)
        holding = np.empty(len(arm.q))
        arm.gravity(holding)
        low, high = robot.torque_limits
        self.errors.reset(step=float(arm.model.opt.timestep), holding=holding, torque_low=low, torque_high=high)
        self._sim, self._steps, self._begun = self._base.sim, 0, True

    def _pre_action(self, action: Any, policy_step: bool = False) -> None:
        self._original(action, policy_step)
        if policy_step:
            self._begin_control_step()
        self._arm.look(self.errors)
        asked = self._controller.torques
        applied, change = self.errors.sub_step(asked)
        self._arm.act(applied, change)
        self._asked.append(asked)
        self._applied.append(applied.copy())

    def _begin_control_step(self) -> None:
        if not self._begun or self._base.sim is not self._sim:
            self._begin()
        self._held = self._watches_grasp and self._grasps()
        self.errors.begin_control_step(max(0, self._steps - self._settle_steps), self._held)
        self._steps += 1
        self._asked, self._applied = [], []

    def _grasps(self) -> bool:
        """Whether both finger pads touch one and the same free body."""
        m, touching = self._arm.model, (set(), set())
        for contact in self._arm.data.contact[:self._arm.data.ncon]:
            for side, pads in enumerate(self._pads):
                for pad, other in ((contact.geom1, contact.geom2), (contact.geom2, contact.geom1)):
                    if pad in pads:
                        root = m.body_rootid[m.geom_bodyid[other]]
                        if m.body_jntnum[root] > 0 and m.jnt_type[m.body_jntadr[root]] == 0:
                            touching[side].add(int(root))
        return bool(touching[0] & touching[1])


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
