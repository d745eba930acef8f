"""The joint errors of a scenario at an arm of any simulator."""
from __future__ import annotations

import ctypes
import weakref
from typing import Any, Callable, Dict, FrozenSet, Optional, Sequence, Set, Tuple, Union

import numpy as np

from robostress._library import (
    ARM, ATTACHED, LIBRARY, Arrays, Copied, Failures, InvalidArgument, Moment, Options, WrongOrder, array, integer,
    number, text)
from robostress.streams import Stream

READS = {1: ("gravity",), 2: ("payload_gravity", "payload_inertia"), 4: ("tilt_gravity",),
         8: ("mass_matrix", "other_torque"), 16: ("ddq",)}
GRASP = 32
INDEXED = {"qpos_index": ("qpos",), "dof_index": ("qvel",), "ctrl_index": ("ctrl",), "joint_index": ("xaxis", "xanchor"),
           "body_index": ("subtree_com", "subtree_mass")}
WIDTH = {"xaxis": 3, "xanchor": 3, "subtree_com": 3}  # of a row; else an entry


def _own_array(name: str, values: Any) -> np.ndarray:
    shape = f"[any, {WIDTH[name]}]" if name in WIDTH else "[any]"
    if not isinstance(values, np.ndarray) or values.dtype != np.float64 or not values.flags.c_contiguous or (
            values.shape[1:] != ((WIDTH[name],) if name in WIDTH else ())) or values.ndim == 0:
        raise InvalidArgument(f"{name} must be the simulator's own contiguous float64 array {shape} to be attached")
    if name in ("qpos", "ctrl") and not values.flags.writeable:
        raise InvalidArgument(f"{name} cannot be written to: give the simulator's own array")
    return values


class JointErrors(Copied):
    """What becomes of an arm's torques, and how far its transmissions move.

        errors = JointErrors("aged_transmission")
        errors.reset(q, gravity=bias)
        each command:   errors.begin_control_step(steps_done, held)
        each sub-step:  applied, change = errors.sub_step(asked, q=q, dq=dq, gravity=bias)
                        the joints get `applied` [Nm]; `change` [rad] is added to their positions

    What these errors read of the arm is `reads`: q and dq, often gravity. Each is an attribute, an array that is filled in
    place or by name in a call; bind(), or setting it, puts the simulator's own array there, so that nothing is copied.
    Arrays that calls return are overwritten by the next call. One thread at a time.

    scenario: a name of scenarios(), or a file (.yaml). severity: 1 (mild) to 5 (full). seed: of stream(); the errors
    themselves draw nothing. horizon: control steps over which severities that grow do so. nominal: [joints, 9] Fc, Fs, vs,
    sigma_v, B, M_eff, D, K, beta of an arm that is no Panda.
    """

    q: np.ndarray
    dq: np.ndarray
    gravity: np.ndarray
    payload_gravity: np.ndarray
    payload_inertia: np.ndarray
    tilt_gravity: np.ndarray
    mass_matrix: np.ndarray
    other_torque: np.ndarray
    torque_low: np.ndarray
    torque_high: np.ndarray
    ddq: np.ndarray
    temperature: np.ndarray

    def __init__(self, scenario: str, joints: int = 7, severity: int = 5, seed: int = 0, *, horizon: int = 300,
                 friction_law: str = "sgn", tanh_width: float = 0.01, offset_start: str = "zero",
                 gravity_sign: str = "literal", nominal: Optional[Any] = None) -> None:
        if not isinstance(scenario, str):
            raise InvalidArgument(f"scenario is {scenario!r}, must be a name of scenarios() or a file's path")
        joints, severity, horizon = (integer(name, value) for name, value in (
            ("joints", joints), ("severity", severity), ("horizon", horizon)))
        seed = integer("seed", seed, -2**63, 2**63 - 1)
        options = Options(ctypes.sizeof(Options), severity, horizon, text("friction_law", friction_law),
                          number("tanh_width", tanh_width), text("offset_start", offset_start),
                          text("gravity_sign", gravity_sign), None)
        if nominal is not None:
            values = array("nominal", nominal, float, joints, 9)
            options.nominal = values.ctypes.data
        self.scenario, self.joints, self.severity, self.seed = scenario, joints, severity, seed
        handle = ctypes.c_void_p()
        self._failures = Failures()
        self._failures.check(LIBRARY.robostress_errors_new(
            text("scenario", scenario), joints, ctypes.addressof(options), ctypes.addressof(handle),
            *self._failures.arguments))
        self._own(handle)

    def _own(self, handle: ctypes.c_void_p) -> None:
        self._handle = handle.value
        self._free = weakref.finalize(self, LIBRARY.robostress_errors_free, self._handle)
        self._free.atexit = False  # others' last calls may come later
        self._moment = Moment(size=ctypes.sizeof(Moment), step=0.002)
        self._sub_steps, self._step = 0, 0.002
        self._asked_array, self._applied, self._change = (np.zeros(self.joints) for _ in range(3))
        self._asked = self._asked_array.data
        self._views: Dict[str, memoryview] = {"asked": self._asked}
        self._bound: Set[str] = set()  # of them, somebody else's arrays
        asked, applied, change = (a.ctypes.data for a in (self._asked_array, self._applied, self._change))
        start = (self._handle, ctypes.addressof(self._moment))
        self._torque = (*start, asked, applied, *self._failures.arguments)
        self._offset_change = (self._handle, applied, change, *self._failures.arguments)
        self._sub_step = (*start, asked, applied, change, *self._failures.arguments)
        for name in self.reads:
            self._read_from(**{name: np.full(self._shape(name), np.nan)})  # so that what nobody fills is refused

    def _shape(self, name: str) -> Tuple[int, ...]:
        if name not in ARM:
            raise InvalidArgument(f"'{name}' is nothing that an arm has; known: {', '.join(ARM)}")
        return {"tilt_gravity": (self.joints, 2), "mass_matrix": (self.joints, self.joints)}.get(name, (self.joints,))

    @property
    def reads(self) -> FrozenSet[str]:
        """What must be given of the arm; may grow with add_effect()."""
        bits = LIBRARY.robostress_errors_reads(self._handle)
        return frozenset(("q", "dq")).union(*(names for bit, names in READS.items() if bits & bit))

    @property
    def reads_grasp(self) -> bool:
        """Whether it matters that the gripper holds an object."""
        return bool(LIBRARY.robostress_errors_reads(self._handle) & GRASP)

    def bind(self, **arrays: np.ndarray) -> None:
        """These arrays themselves are read from now on: float64, contiguous, of the arm's shapes. Nothing is written there."""
        self._read_from(**arrays)
        self._bound.update(arrays)

    def _read_from(self, **arrays: np.ndarray) -> None:
        for name, values in arrays.items():
            shape = self._shape(name)
            if not isinstance(values, np.ndarray) or values.dtype != np.float64 or values.shape != shape or (
                    not values.flags.c_contiguous):
                raise InvalidArgument(f"{name} must be a contiguous float64 array of shape {list(shape)} to be bound; "
                                      "give others by name in each call, which copies")
            self._views[name] = values.data
            setattr(self._moment, name, values.ctypes.data)

    def _fill(self, arm: Dict[str, Any]) -> None:
        if not self._bound.isdisjoint(arm):
            taken = sorted(self._bound.intersection(arm))
            raise InvalidArgument(f"{', '.join(taken)}: your own arrays are bound and read; write there, and leave out the names")
        for name, values in arm.items():
            try:
                self._views[name][:] = values  # a memoryview takes a third of an array's time
            except (KeyError, TypeError, ValueError, NotImplementedError):
                self._convert(name, values)

    def _convert(self, name: str, values: Any) -> None:
        if name not in self._views:  # one that these errors need not have
            self._read_from(**{name: np.empty(self._shape(name))})
        kept = np.asarray(self._views[name])
        try:
            if np.iscomplexobj(values):  # NumPy takes the real parts
                raise TypeError("complex numbers have no place here")
            given = np.asarray(values, float)
        except (TypeError, ValueError, OverflowError) as fault:
            raise InvalidArgument(f"{name}: {fault}; must be numbers of shape {list(kept.shape)}") from fault
        if given.shape not in ((), kept.shape):  # a number alone is that of every joint
            raise InvalidArgument(f"{name} has shape {list(given.shape)}, must be of shape {list(kept.shape)}")
        kept[...] = given

    def _begin(self, asked: Any, arm: Dict[str, Any]) -> None:
        if arm:
            self._fill(arm)
        try:
            self._asked[:] = asked
        except (TypeError, ValueError):
            self._convert("asked", asked)
        self._moment.time = self._sub_steps * self._step

    def add_effect(self, joint: int, effect: str, values: Sequence[float], coupled: int = -1) -> None:
        """An effect of the library at a joint, from the next reset on; values in the order of `robostress scenarios
        --effects`."""
        joint, coupled = integer("joint", joint), integer("coupled", coupled)
        given = array("values", values, float, -1)
        self._failures.check(LIBRARY.robostress_errors_add_effect(
            self._handle, joint, text("effect", effect), given.ctypes.data, len(given), coupled, *self._failures.arguments))
        for name in self.reads:
            if name not in self._views:
                self._read_from(**{name: np.full(self._shape(name), np.nan)})

    def reset(self, q: Optional[Any] = None, *, step: float = 0.002, holding: Optional[Any] = None, **arm: Any) -> None:
        """An episode begins at rest at q, or where the bound arrays say. step: length of a sub-step [s]; holding: the motors'
        torques that hold the arm."""
        step = number("step", step)
        self._moment.time, self._moment.step, self._step = 0, step, step
        self._fill(arm if q is None else {"q": q, "dq": 0, **arm})
        held = None if holding is None else array("holding", holding, float, self.joints)
        self._failures.check(LIBRARY.robostress_errors_reset(
            self._handle, ctypes.addressof(self._moment), None if held is None else held.ctypes.data,
            *self._failures.arguments))
        self._sub_steps = 0

    def begin_control_step(self, steps_done: int, held: bool = False) -> None:
        """steps_done: control steps of the episode before this one; held: whether the gripper holds an object."""
        LIBRARY.robostress_errors_begin_control_step(self._handle, integer("steps_done", steps_done), bool(held))

    def sub_step(self, asked: Any, **arm: Any) -> Tuple[np.ndarray, np.ndarray]:
        """(applied, change): torques that the joints get of those `asked` for [Nm], and what is added to their positions."""
        self._begin(asked, arm)
        code = _sub_step(*self._sub_step)
        if code:
            self._failures.check(code)
        self._sub_steps += 1
        return self._applied, self._change

    def torque(self, asked: Any, **arm: Any) -> np.ndarray:
        """The first half of sub_step(), where the arm's torques may yet change."""
        self._begin(asked, arm)
        self._failures.check(LIBRARY.robostress_errors_torque(*self._torque))
        self._sub_steps += 1
        return self._applied

    def offset_change(self, applied: Optional[Any] = None) -> np.ndarray:
        """The second half. applied: torques that the joints really got; None: those of torque()."""
        if applied is not None:
            self._applied[...] = array("applied", applied, float, self.joints)
        self._failures.check(LIBRARY.robostress_errors_offset_change(*self._offset_change))
        return self._change

    def attach(self, field: Any, *, rows: int = 1, tool: Optional[np.ndarray] = None, gear: Optional[Any] = None,
               slides: Optional[Any] = None, **arrays: Any) -> None:
        """A simulator's own arrays for act(), laid out as MuJoCo's: qpos, qvel, ctrl, xaxis, xanchor, subtree_com,
        subtree_mass; qpos_index, dof_index, ctrl_index, joint_index, body_index [joints]. field: of gravity [m/s^2].
        tool: [3] where a payload sits. gear: torque of each motor per unit of ctrl; None: 1. slides: [joints] whether each
        slides along its axis; None: all turn. rows: sub-steps of a control step whose torques `record` [rows, 2, joints]
        keeps: asked for, applied.
        """
        attached = Arrays(ctypes.sizeof(Arrays))
        attached.field[:] = array("field", field, float, 3)
        rows = integer("rows", rows, 0)
        given = {**arrays, **({} if tool is None else {"tool": tool}),
                 **({} if gear is None else {"gear": array("gear", gear, float, self.joints)}),
                 **({} if slides is None else {"slides": array("slides", slides, np.uint8, self.joints)})}
        if set(arrays) != set(ATTACHED):
            raise InvalidArgument(f"arrays {sorted(arrays)} are given, must be {sorted(ATTACHED)}")
        for name, of in INDEXED.items():
            given[name] = self._indices(name, given[name], {each: len(_own_array(each, given[each])) for each in of})
        if tool is not None and len(_own_array("tool", tool)) != 3:
            raise InvalidArgument(f"tool has {len(tool)} entries, must be 3: a position")
        for name in (*ATTACHED, *(optional for optional in ("tool", "gear", "slides") if optional in given)):
            setattr(attached, name, given[name].ctypes.data)
        record = np.zeros((rows, 2, self.joints))
        self._failures.check(LIBRARY.robostress_errors_attach(
            self._handle, ctypes.addressof(self._moment), ctypes.addressof(attached), self._asked_array.ctypes.data,
            record.ctypes.data, rows, *self._failures.arguments))
        self.record, self._attached = record, (given, attached)

    def _indices(self, name: str, given: Any, rows: Dict[str, int]) -> np.ndarray:
        """[joints] within arrays of so many `rows`: nothing checks them later."""
        wished = np.asarray(given)
        if wished.dtype.kind not in "iu":
            raise InvalidArgument(f"{name} is {given!r}, must be {self.joints} whole numbers")
        wished = array(name, wished, np.int64, self.joints)
        short = min(rows, key=lambda each: rows[each])
        for index in wished:
            if not 0 <= index < rows[short]:
                raise InvalidArgument(f"{name} has {index}, must be 0 to {rows[short] - 1}: {short} has {rows[short]} rows")
        if name != "body_index" and len(set(wished.tolist())) < len(wished):  # a body may have several joints
            raise InvalidArgument(f"{name} is {wished.tolist()}: an arm has each of its joints once")
        return wished.astype(np.intc)

    def reset_attached(self, step: float = 0.002) -> None:
        """reset() where the attached arrays are, the motors holding the arm against gravity."""
        self._moment.step = self._step = number("step", step)
        self._failures.check(_reset_attached(self._handle, *self._failures.arguments))

    def actor(self, controller: Any) -> Callable[[], None]:
        """act() as a call that takes what it is asked for from controller.torques."""
        asked, handle, failures = self._asked, self._handle, self._failures
        error = failures.arguments

        def act() -> None:
            try:
                asked[:] = controller.torques
            except (TypeError, ValueError):
                self._convert("asked", controller.torques)
            code = _act_attached(handle, *error)
            if code:
                failures.check(code)
        return act

    def sub_step_of(self, controller: Any, physics: Callable[[], Any]) -> Callable[..., Any]:
        """act(controller.torques), then physics(), whose result it returns, whatever it is given; in CPython a built-in
        function."""
        def act_and_go_on(torques: Any) -> Any:
            self.act(torques)
            return physics()

        if not _sub_step_method:
            return lambda *_: act_and_go_on(controller.torques)
        bound = (self._handle, self._asked_array.ctypes.data, controller, "torques", physics, act_and_go_on, self)
        return _new_built_in(_sub_step_method, bound, None)

    def act(self, asked: Any) -> None:
        """sub_step() in the attached arrays: ctrl gets what is applied, qpos the change, `record` both torques."""
        try:
            self._asked[:] = asked
        except (TypeError, ValueError):
            self._convert("asked", asked)
        self._failures.check(_act_attached(self._handle, *self._failures.arguments))

    @property
    def recorded(self) -> np.ndarray:
        """Of `record` the sub-steps since begin_control_step() [played, 2, joints], the first `rows` of them."""
        return self.record[:LIBRARY.robostress_errors_recorded(self._handle)]

    def offset(self) -> np.ndarray:
        """Link angle minus motor angle now [joints]."""
        values = np.empty(self.joints)
        LIBRARY.robostress_errors_offset(self._handle, values.ctypes.data)
        return values

    def reading(self, q: Any, dq: Any) -> Tuple[np.ndarray, np.ndarray]:
        """What the controller reads of joints at q, dq."""
        positions, rates = array("q", q, float, self.joints), array("dq", dq, float, self.joints)
        reading, rate = np.empty(self.joints), np.empty(self.joints)
        LIBRARY.robostress_errors_reading(self._handle, positions.ctypes.data, rates.ctypes.data, reading.ctypes.data,
                                          rate.ctypes.data)
        return reading, rate

    def copy(self) -> "JointErrors":
        """One that goes on as this one would, with arrays of its own."""
        twin = object.__new__(type(self))
        twin.scenario, twin.joints, twin.severity, twin.seed = self.scenario, self.joints, self.severity, self.seed
        twin._failures, handle = Failures(), ctypes.c_void_p()
        twin._failures.check(LIBRARY.robostress_errors_copy(self._handle, ctypes.addressof(handle),
                                                            *twin._failures.arguments))
        twin._own(handle)
        twin._clock_of(self)
        twin._fill({name: np.asarray(view) for name, view in self._views.items()})
        return twin

    def restore(self, saved: "JointErrors") -> None:
        """Makes this what `saved`, a copy(), is; its arrays stay."""
        if saved.joints != self.joints:
            raise WrongOrder(f"the copy has {saved.joints} joints, this {self.joints}: restore what was copied of it")
        self._failures.check(LIBRARY.robostress_errors_restore(self._handle, saved._handle, *self._failures.arguments))
        self._clock_of(saved)

    def _clock_of(self, other: "JointErrors") -> None:
        self._moment.step = self._step = other._step
        self._sub_steps = other._sub_steps

    def stream(self, purpose: str, *parts: Union[str, int]) -> Stream:
        """Draws of this seed, for noise of one's own."""
        return Stream(purpose, self.seed, *parts)


def _attribute(name: str) -> property:
    def bound(self: JointErrors) -> np.ndarray:
        if name not in self._views:
            raise AttributeError(name)
        return self._views[name].obj  # type: ignore[return-value]

    def bind(self: JointErrors, values: np.ndarray) -> None:
        self.bind(**{name: values})
    return property(bound, bind)


for _name in ARM:
    setattr(JointErrors, _name, _attribute(_name))

_sub_step = LIBRARY.robostress_errors_sub_step
_act_attached = LIBRARY.robostress_errors_act_attached
_reset_attached = LIBRARY.robostress_errors_reset_attached
_sub_step_method: Optional[int] = LIBRARY.robostress_cpython_sub_step()
if _sub_step_method:
    _new_built_in = ctypes.pythonapi.PyCFunction_NewEx
    _new_built_in.restype, _new_built_in.argtypes = ctypes.py_object, (ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p)
