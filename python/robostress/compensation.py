"""Compensators: what an arm did with a policy's commands corrects the next ones. No weights, any policy."""
from __future__ import annotations

import ctypes
import weakref
from typing import Any, Dict, List, Optional

import numpy as np

from robostress._library import LIBRARY, Control, Copied, Executed, Failures, InvalidArgument, array, integer, number, text


MOST_ROWS = 1024  # that executed() takes at once
UNIT = 1e-3  # |q| - 1 of a unit quaternion, at most, as in C


def _text(value: Any) -> str:
    return str(value).lower() if isinstance(value, (bool, np.bool_)) else str(value)


class Compensator(Copied):
    """Stands between a policy and a controller. One robot; one thread at a time.

        compensator.start_episode()
        each chunk:  sent = compensator.correct(policy_actions)               # [rows, action_dim]
                     ... the arm executes n of them ...
                     compensator.executed(positions, quaternions)             # [n + 1, 3], [n + 1, 4] w x y z

    or, where actions come one at a time:  sent = compensator.step(policy_action, position, quaternion)

    method: "base", "gain", "smooth", "direct", "ours_integral", "ours_following", "ours_following_step",
    "ours_following_smooth"; options: its own, as in `robostress sweep --set`. The last two and "smooth" act at every command,
    by next() or step(). Commands of space "end_effector" are displacements in x, y, z and rotations about them, in units of
    the scales, and a gripper; of "joint" absolute targets [rad] and a gripper. goal_reference: of the controller, "achieved"
    as robosuite's or "desired". action_low, action_high: [action_dim] what the policy's actions lie in. rows: actions after
    which step() learns where the method does not at every one (8).
    """

    def __init__(self, method: str, *, space: str = "end_effector", action_dim: int = 7, control_period: float = 0.05,
                 translation_scale: float = 0.05, rotation_scale: float = 0.5, goal_reference: str = "achieved",
                 action_low: Optional[Any] = None, action_high: Optional[Any] = None, rows: Optional[int] = None,
                 **options: Any) -> None:
        action_dim = integer("action_dim", action_dim)
        control = Control(ctypes.sizeof(Control), text("space", space), action_dim, *(number(name, value) for name, value in (
            ("control_period", control_period), ("translation_scale", translation_scale), ("rotation_scale", rotation_scale))),
                          text("goal_reference", goal_reference), None, None)
        bounds = []
        for name, values in (("action_low", action_low), ("action_high", action_high)):
            if values is not None:
                bounds.append(array(name, values, np.float32, action_dim))
                setattr(control, name, bounds[-1].ctypes.data)
        overrides = [text(key, f"{key}={_text(value)}") for key, value in options.items()]
        texts = (ctypes.c_char_p * len(overrides))(*overrides)
        self.method, self.action_dim, self.space = method, action_dim, space
        self._failures, handle = Failures(), ctypes.c_void_p()
        self._failures.check(LIBRARY.robostress_compensator_new(
            text("method", method), ctypes.addressof(texts), len(overrides), ctypes.addressof(control),
            ctypes.addressof(handle), *self._failures.arguments))
        self._own(handle)
        if rows is not None and self.every_step:
            raise InvalidArgument(f"rows={rows} would change nothing: method '{method}' learns after every action")
        self._rows = 1 if self.every_step else 8 if rows is None else integer("rows", rows, 1, MOST_ROWS)

    def _own(self, handle: ctypes.c_void_p) -> None:
        self._handle = handle.value
        weakref.finalize(self, LIBRARY.robostress_compensator_free, self._handle)
        self._forget()

    def _forget(self) -> None:
        self._policy = self._sent = np.empty((0, self.action_dim), np.float32)
        self._row = 0  # of them, which next() gives next
        self._steps: List[Dict[str, np.ndarray]] = []  # of step(), since it learned

    @property
    def every_step(self) -> bool:
        """Whether commands are corrected one by one, by next() or step()."""
        return bool(LIBRARY.robostress_compensator_every_step(self._handle))

    def start_episode(self) -> None:
        """The arm is at rest."""
        LIBRARY.robostress_compensator_start_episode(self._handle)
        self._forget()

    def correct(self, actions: Any) -> np.ndarray:
        """[rows, action_dim] what to send instead of the policy's next chunk."""
        policy = array("actions", actions, np.float32, -1, self.action_dim)
        sent = np.empty_like(policy)
        self._failures.check(LIBRARY.robostress_compensator_correct(
            self._handle, policy.ctypes.data, len(policy), sent.ctypes.data, *self._failures.arguments))
        self._policy, self._sent, self._row = policy.copy(), sent, 0
        return sent.copy()

    def next(self, position: Optional[Any] = None, orientation: Optional[Any] = None, **more: Any) -> np.ndarray:
        """[action_dim] the chunk's next command, row by row: with every_step corrected by what the arm did since.
        position, orientation: [2, 3], [2, 4] before and after the row that was executed last; none at the first row.
        more: as of executed(); by default sent is what next() gave."""
        command = np.empty(self.action_dim, np.float32)
        executed = None
        measured = more.get("q") if position is None else position
        if measured is not None:
            executed = self._read(position, orientation, **{"first_row": max(self._row + 1 - len(measured), 0), **more})
        self._failures.check(LIBRARY.robostress_compensator_next(
            self._handle, None if executed is None else ctypes.addressof(executed), command.ctypes.data,
            *self._failures.arguments))
        self._sent[self._row] = command
        self._row += 1
        return command

    def executed(self, position: Optional[Any] = None, orientation: Optional[Any] = None, **more: Any) -> None:
        """Once for every chunk, when it is over. position, orientation: [n + 1, 3], [n + 1, 4] of the end effector before,
        between and after the n commands. q: [n + 1, action_dim - 1] of joint commands. sent, policy: [n, action_dim] what
        the controller got and what the policy asked for; by default the first n rows of correct(), or what next() gave.
        masked: [n] steps that say nothing about the arm."""
        executed = self._read(position, orientation, **more)
        self._failures.check(LIBRARY.robostress_compensator_executed(
            self._handle, ctypes.addressof(executed), *self._failures.arguments))

    def step(self, action: Any, position: Optional[Any] = None, orientation: Optional[Any] = None,
             q: Optional[Any] = None) -> np.ndarray:
        """[action_dim] what to send instead of one action of the policy, in a loop without chunks. position, orientation: [3],
        [4] of the end effector now; q: [action_dim - 1] of joint commands. Not together with correct() in one episode."""
        state = self._now(position, orientation, q)
        if len(self._steps) == self._rows:
            self._learn(state)
        policy = array("action", action, np.float32, self.action_dim)
        self.correct(policy[None])
        sent = self.next()
        self._steps.append({**state, "policy": policy.copy(), "sent": sent.copy()})
        return sent

    def end_episode(self, position: Optional[Any] = None, orientation: Optional[Any] = None,
                    q: Optional[Any] = None) -> None:
        """Where the last action of step() brought the arm, for what is carried into the next episode. May be left out."""
        state = self._now(position, orientation, q)
        if self._steps:
            self._learn(state)

    def _now(self, position: Optional[Any], orientation: Optional[Any], q: Optional[Any]) -> Dict[str, np.ndarray]:
        given = {"q": (q, self.action_dim - 1)} if self.space == "joint" else {
            "position": (position, 3), "orientation": (orientation, 4)}
        for name, (value, _) in given.items():
            if value is None:
                raise InvalidArgument(f"nothing says where the arm is: give {name}")
        state = {name: array(name, value, float, size).copy() for name, (value, size) in given.items()}
        for name, values in state.items():  # before anything is kept: else every later step would fail on it
            if not np.isfinite(values).all():
                raise InvalidArgument(f"{name} is {values.tolist()}, must be finite; leave out the step, or say where the arm was "
                                      "last")
        length = float(np.linalg.norm(state.get("orientation", (1.0,))))
        if abs(length - 1) > UNIT:
            raise InvalidArgument(f"orientation has length {length:.4g}, must be 1: a unit quaternion w x y z")
        return state

    def _learn(self, state: Dict[str, np.ndarray]) -> None:
        steps, self._steps = self._steps, []
        states = steps + [state]
        self.executed(**{name: np.array([each[name] for each in states]) for name in state},
                      **{name: np.array([each[name] for each in steps]) for name in ("policy", "sent")})

    def residual(self, position: Optional[Any] = None, orientation: Optional[Any] = None, **more: Any) -> np.ndarray:
        """[n, action_dim] achieved minus commanded (paper, Eq. 1), as of executed(); changes nothing."""
        executed = self._read(position, orientation, **more)
        values = np.empty((executed.steps, self.action_dim))
        self._failures.check(LIBRARY.robostress_compensator_residual(
            self._handle, ctypes.addressof(executed), values.ctypes.data, *self._failures.arguments))
        return values

    @property
    def correction(self) -> np.ndarray:
        """[action_dim - 1] what is added to each command of the next chunk."""
        values = np.empty(self.action_dim - 1)
        LIBRARY.robostress_compensator_correction(self._handle, values.ctypes.data)
        return values

    def copy(self) -> "Compensator":
        """One that goes on as this one would."""
        twin = object.__new__(type(self))
        twin.method, twin.action_dim, twin.space, twin._rows = self.method, self.action_dim, self.space, self._rows
        twin._failures, handle = Failures(), ctypes.c_void_p()
        twin._failures.check(LIBRARY.robostress_compensator_copy(
            self._handle, ctypes.addressof(handle), *twin._failures.arguments))
        twin._own(handle)
        twin._policy, twin._sent, twin._row, twin._steps = self._policy, self._sent.copy(), self._row, list(self._steps)
        return twin

    def _read(self, position: Optional[Any], orientation: Optional[Any], q: Optional[Any] = None,
              sent: Optional[Any] = None, policy: Optional[Any] = None, masked: Optional[Any] = None,
              first_row: int = 0) -> Executed:
        measured = q if self.space == "joint" else position
        if measured is None:
            raise InvalidArgument(f"nothing says where the arm was: give {'q' if self.space == 'joint' else 'position'}")
        n = len(measured) - 1
        if n < 1:
            raise InvalidArgument(f"{n + 1} states are no motion: give one before and one after each command")
        rows = slice(first_row, first_row + n)
        arrays = {"policy_command": array("policy", self._policy[rows] if policy is None else policy, np.float32, n,
                                          self.action_dim),
                  "sent_command": array("sent", self._sent[rows] if sent is None else sent, np.float32, n,
                                        self.action_dim)}
        if position is not None:
            arrays["position"] = array("position", position, float, n + 1, 3)
        if orientation is not None:
            arrays["orientation"] = array("orientation", orientation, float, n + 1, 4)
        if q is not None:
            arrays["q"] = array("q", q, float, n + 1, self.action_dim - 1)
        if masked is not None:
            arrays["masked"] = array("masked", masked, np.uint8, n)
        executed = Executed(ctypes.sizeof(Executed), n)
        for name, values in arrays.items():
            setattr(executed, name, values.ctypes.data)
        executed.arrays = arrays  # live as long as it
        return executed


class ModelFollowing(Compensator):
    """Leads the arm after a nominal one that gets the policy's commands. every_step: corrects each command anew."""

    def __init__(self, *, every_step: bool = False, **more: Any) -> None:
        super().__init__("ours_following_step" if every_step else "ours_following", **more)


class IntegralAction(Compensator):
    """Takes off a disturbance that stays."""

    def __init__(self, **more: Any) -> None:
        super().__init__("ours_integral", **more)


class DirectSubtraction(Compensator):
    """Subtracts the mean residual of the chunk before."""

    def __init__(self, **more: Any) -> None:
        super().__init__("direct", **more)


class GainControl(Compensator):
    """Commands times a factor."""

    def __init__(self, gain: float = 1.15, **more: Any) -> None:
        super().__init__("gain", gain=gain, **more)
