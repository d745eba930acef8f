"""The joint errors of one arm in a MuJoCo model, whoever steps it."""
from __future__ import annotations

from typing import Any, Callable, Dict, List, Optional, Sequence

import numpy as np

from robostress._library import InvalidArgument
from robostress.joint_errors import JointErrors

MEASURED = ("mass_matrix", "other_torque", "ddq")  # what act() does not read itself


def put_back(owner: Any, name: str, replaced: Any) -> None:
    """`owner` has again what its own attribute `name` was, None: that of its class."""
    if replaced is None:
        delattr(owner, name)
    else:
        setattr(owner, name, replaced)


class Hooked:
    """Stands in the methods of the environment that it wraps; a copy's would still act on that one."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError("an environment with joint errors cannot be copied or pickled: they live in the methods of the one that is "
                        "wrapped; unwrap() it before, or make another environment and wrap that")


class MujocoArm:
    """joints, motors: ids in the model, from the base on. tool: the site where a payload sits. pads: geoms of both sides of
    the gripper. rows: sub-steps of a control step. The model and its data stay as long as this does.

    A motor gets what is left of its torque in `ctrl`. Of a servo (affine bias: <position>, <velocity>, <general>) `ctrl` stays
    what was commanded; the difference to what it would give goes into `qfrc_applied` of its joint, until the control step is
    over.
    """

    def __init__(self, model: Any, data: Any, joints: Sequence[int], motors: Sequence[int], errors: JointErrors, *,
                 tool: Optional[int] = None, pads: Sequence[Sequence[int]] = (), rows: int = 1) -> None:
        m, d = model, data
        self.model, self.data, self.errors = m, d, errors
        joint, self.motor = np.array(joints), np.array(motors)
        self.qpos, self.dof = m.jnt_qposadr[joint], m.jnt_dofadr[joint]
        self._check(joint)
        self.servos = bool(np.any(m.actuator_biastype[self.motor] != 0))
        self.gear = np.ones(len(motors)) if self.servos else m.actuator_gear[self.motor, 0] * m.actuator_gainprm[self.motor, 0]
        self._torques = np.zeros(m.nu)  # of servos: what the joints get
        limited = getattr(m, "jnt_actfrclimited", np.zeros(m.njnt))[joint] != 0  # from MuJoCo 2.3.3 on
        self._joint_limits = np.full((len(joint), 2), [-np.inf, np.inf])
        if limited.any():
            self._joint_limits[limited] = m.jnt_actfrcrange[joint[limited]]
        low, high = self._limits()
        errors.bind(torque_low=low, torque_high=high)
        self.fields = [(getattr(self, "_" + name), getattr(errors, name)) for name in MEASURED if name in errors.reads]
        errors.attach(m.opt.gravity, rows=rows, tool=None if tool is None else d.site_xpos[tool],
                      gear=None if np.all(self.gear == 1) else self.gear, slides=m.jnt_type[joint] == 2,
                      qpos=d.qpos, qvel=d.qvel,
                      ctrl=self._torques if self.servos else d.ctrl,
                      xaxis=d.xaxis, xanchor=d.xanchor, subtree_com=d.subtree_com, subtree_mass=m.body_subtreemass,
                      qpos_index=self.qpos, dof_index=self.dof, ctrl_index=self.motor, joint_index=joint,
                      body_index=m.jnt_bodyid[joint])
        self._others: Optional[np.ndarray] = None  # qfrc_applied, without what is the errors' in a control step
        self._watch(pads)
        if tool is None and "payload_gravity" in errors.reads:
            raise InvalidArgument("the scenario has a payload: name the site where it sits, tool='...'")

    def _check(self, joint: np.ndarray) -> None:
        m, motor = self.model, self.motor
        turns = np.isin(m.jnt_type[joint], (2, 3))  # slide, hinge
        drives = (m.actuator_trntype[motor] == 0) & (m.actuator_trnid[motor, 0] == joint)
        plain = (m.actuator_gaintype[motor] == 0) & (m.actuator_biastype[motor] <= 1) & (m.actuator_dyntype[motor] == 0)
        for index in np.flatnonzero(~(turns & drives & plain)):
            raise InvalidArgument(f"actuator {motor[index]} at joint {joint[index]} of the model is no motor or servo of one "
                                  "hinge or slide without an activation of its own: the errors bend torques; name <motor>, "
                                  "<position> or <velocity> actuators of joints")

    def _limits(self) -> Sequence[np.ndarray]:
        m, ends = self.model, self._joint_limits.copy()
        motors = () if self.servos else ((m.actuator_ctrllimited, m.actuator_ctrlrange, self.gear),)
        for limited, given, scale in (*motors,
                                      (m.actuator_forcelimited, m.actuator_forcerange, m.actuator_gear[self.motor, 0])):
            on = limited[self.motor] != 0
            bounds = np.sort(given[self.motor] * scale[:, None], axis=1)
            ends[on, 0], ends[on, 1] = np.maximum(ends, bounds)[on, 0], np.minimum(ends, bounds)[on, 1]
        return np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1])

    def q(self) -> np.ndarray:
        return self.data.qpos[self.qpos]

    def dq(self) -> np.ndarray:
        return self.data.qvel[self.dof]

    @property
    def torques(self) -> np.ndarray:
        """What `ctrl` asks for [Nm]."""
        ctrl = self.commands()
        return self._servo_torques(ctrl) if self.servos else self.gear * ctrl

    def commands(self) -> np.ndarray:
        """`ctrl` of the arm's motors within their ranges."""
        m, ctrl = self.model, self.data.ctrl[self.motor]
        bounds = m.actuator_ctrlrange[self.motor]
        return np.where(m.actuator_ctrllimited[self.motor] != 0, np.clip(ctrl, bounds[:, 0], bounds[:, 1]), ctrl)

    def _servo_torques(self, ctrl: np.ndarray) -> np.ndarray:
        """gear (gain ctrl + b0 + b1 length + b2 speed), force and torque within their limits; MuJoCo, Actuation model."""
        m, motor, bias = self.model, self.motor, self.model.actuator_biasprm[self.motor]
        affine = (m.actuator_biastype[motor] == 1)[:, None] * bias[:, :3]
        gear = m.actuator_gear[motor, 0]
        force = m.actuator_gainprm[motor, 0] * ctrl + affine[:, 0] + gear * (affine[:, 1] * self.q() + affine[:, 2] * self.dq())
        ends = m.actuator_forcerange[motor]
        torque = gear * np.where(m.actuator_forcelimited[motor] != 0, np.clip(force, ends[:, 0], ends[:, 1]), force)
        return np.clip(torque, self._joint_limits[:, 0], self._joint_limits[:, 1])

    def begin_episode(self) -> None:
        elsewhere = self.q() + 0.0123
        if not np.array_equal(self.errors.reading(elsewhere, self.dq())[0], elsewhere):
            raise InvalidArgument("the scenario bends what encoders read, and this environment takes positions from the "
                                  "simulator: leave out its effects of stage sensor")
        self.look()
        self._others = None
        self.errors.reset_attached(float(self.model.opt.timestep))

    def look(self) -> None:
        """Fills what act() does not read itself."""
        for read, field in self.fields:
            field[:] = read()

    def actor(self, controller: Any) -> Callable[[], Any]:
        """What a sub-step calls. controller: has the `torques` that it asks for now."""
        act = self.errors.actor(controller)
        if self.servos:
            act = self._servo_actor(act)
        if not self.fields:
            return act

        def look_and_act() -> None:
            self.look()
            act()
        return look_and_act

    def sub_step(self, controller: Any, physics: Callable[[], Any]) -> Callable[..., Any]:
        """actor(), then physics(), whose result it returns; it takes any arguments."""
        if not self.servos and not self.fields:
            return self.errors.sub_step_of(controller, physics)
        act = self.actor(controller)

        def act_and_go_on(*_: Any) -> Any:
            act()
            return physics()
        return act_and_go_on

    def _servo_actor(self, act: Callable[[], Any]) -> Callable[[], Any]:
        def act_beside_servos() -> None:
            act()
            if self._others is None:
                self._others = self.data.qfrc_applied[self.dof]
            # The servo acts at the positions that the errors have moved.
            self.data.qfrc_applied[self.dof] = self._others + (self._torques[self.motor] - self.torques)
        return act_beside_servos

    def end_control_step(self) -> None:
        """What is the errors' of qfrc_applied goes."""
        if self._others is not None:
            self.data.qfrc_applied[self.dof], self._others = self._others, None

    def _mass_matrix(self) -> np.ndarray:
        import mujoco  # type: ignore[import-not-found]
        full = np.zeros((self.model.nv, self.model.nv))
        if hasattr(self.data, "qM"):
            mujoco.mj_fullM(self.model, full, self.data.qM)
        else:  # from MuJoCo 4 on
            mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.dof, self.dof)]

    def _other_torque(self) -> np.ndarray:
        d = self.data
        return d.qfrc_passive[self.dof] - d.qfrc_bias[self.dof] + d.qfrc_constraint[self.dof]

    def _ddq(self) -> np.ndarray:
        return self.data.qacc[self.dof]

    def holds(self) -> bool:
        """Whether both sides of the gripper touch one and the same free body."""
        if not self._pads:
            return False
        contact, count = self.data.contact, self.data.ncon
        first, second = contact.geom1[:count].tolist(), contact.geom2[:count].tolist()
        touched = {(self._pads[a], self._free[b]) for a, b in (*zip(first, second), *zip(second, first))
                   if a in self._pads and b >= 0}
        return any(side == 1 and body >= 0 and (2, body) in touched for side, body in touched)

    def _watch(self, pads: Sequence[Sequence[int]]) -> None:
        """_pads: of the gripper's geoms the side, 1 or 2. _free: of each geom the free body that it is of, else -1."""
        m = self.model
        self._pads: Dict[int, int] = {}
        if not self.errors.reads_grasp:
            return
        if len(pads) != 2:
            raise InvalidArgument("the scenario depends on a grasp: name the geoms of both sides of the gripper, pads=(...)")
        self._pads = {int(geom): side for side, geoms in enumerate(pads, 1) for geom in geoms}
        root = m.body_rootid[m.geom_bodyid]
        free = (m.body_jntnum[root] > 0) & (m.jnt_type[m.body_jntadr[root]] == 0)
        self._free: List[int] = np.where(free, root, -1).tolist()


class ArmEpisode:
    """An arm with its errors through control steps: when an episode begins, how far it is, what was done."""

    def __init__(self, name: str, errors: JointErrors, settle_steps: int, make: Callable[[], MujocoArm]) -> None:
        self.name, self.errors, self.settle_steps, self._make = name, errors, settle_steps, make
        self.arm: Optional[MujocoArm] = None
        self.steps, self.held, self.begun = 0, False, False
        self.last: Dict[str, Any] = {}  # what executed() said
        self.act: Optional[Callable[[], Any]] = None  # of the control step under way; None before its first sub-step

    def begin_control_step(self) -> MujocoArm:
        """With the model's positions up to date, before the first torques of a command."""
        if not self.begun or self.arm is None:
            self.arm = self._make()
            self.arm.begin_episode()
            self.steps, self.begun = 0, True
        self.held = self.arm.holds()
        self.errors.begin_control_step(max(0, self.steps - self.settle_steps), self.held)
        self.steps += 1
        return self.arm

    def sub_step(self, model: Any, data: Any, ctrl: Any) -> None:
        """Between a command and a step of the physics, for simulators whose positions nobody brings up to date in between."""
        import mujoco  # type: ignore[import-not-found]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        if self.act is None:
            arm = self.begin_control_step()
            self.act = arm.actor(arm)
        assert self.arm is not None
        if self.arm.fields:
            mujoco.mj_crb(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        data.ctrl[:] = ctrl
        if not self.arm.servos:
            data.ctrl[self.arm.motor] = self.arm.commands()
        self.act()

    def executed(self, action: Any) -> Dict[str, Any]:
        """What became of a command."""
        assert self.arm is not None  # begin_control_step() was called
        self.arm.end_control_step()
        record = self.errors.recorded.copy()
        self.last = {"commanded": np.array(action), "asked": record[:, 0], "applied": record[:, 1], "q": self.arm.q(),
                     "dq": self.arm.dq(), "held": self.held}
        return self.last
