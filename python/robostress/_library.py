"""librobostress.so as ctypes sees it."""
from __future__ import annotations

import ctypes
import operator
import os
import pathlib
from typing import Any, Dict, List, NamedTuple, Tuple

import numpy as np

INTERFACE = 7
ERROR_SIZE = 1024


class RobostressError(Exception):
    """Says value, limit and remedy."""


class InvalidArgument(RobostressError, ValueError):
    """A value that the message names."""


class NotFound(RobostressError, LookupError):
    """A name; the message lists the known ones."""


class WrongOrder(RobostressError, RuntimeError):
    """A call that must follow another one."""


class InternalError(RobostressError, RuntimeError):
    """A fault of the library."""


class StorageError(RobostressError, OSError):
    """A disk that is full, a file that cannot be written or read."""


KINDS = {3: InvalidArgument, 5: NotFound, 9: WrongOrder, 14: StorageError}


class Options(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("severity", ctypes.c_int), ("horizon", ctypes.c_int),
                ("friction_law", ctypes.c_char_p), ("tanh_width", ctypes.c_double), ("offset_start", ctypes.c_char_p),
                ("gravity_sign", ctypes.c_char_p), ("nominal", ctypes.c_void_p)]


ARM = ("q", "dq", "gravity", "payload_gravity", "payload_inertia", "tilt_gravity", "mass_matrix", "other_torque",
       "torque_low", "torque_high", "ddq", "temperature")


class Moment(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("time", ctypes.c_double), ("step", ctypes.c_double),
                *((name, ctypes.c_void_p) for name in ARM)]


ATTACHED = ("qpos", "qvel", "ctrl", "xaxis", "xanchor", "subtree_com", "subtree_mass", "qpos_index", "dof_index",
            "ctrl_index", "joint_index", "body_index")


class Arrays(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), *((name, ctypes.c_void_p) for name in ATTACHED), ("field", ctypes.c_double * 3),
                ("tool", ctypes.c_void_p), ("gear", ctypes.c_void_p), ("slides", ctypes.c_void_p)]


class Control(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("space", ctypes.c_char_p), ("action_dim", ctypes.c_int),
                ("control_period", ctypes.c_double), ("translation_scale", ctypes.c_double),
                ("rotation_scale", ctypes.c_double), ("goal_reference", ctypes.c_char_p),
                ("action_low", ctypes.c_void_p), ("action_high", ctypes.c_void_p)]


class Executed(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("steps", ctypes.c_size_t)] + [
        (name, ctypes.c_void_p) for name in
        ("position", "orientation", "q", "policy_command", "sent_command", "masked")]


class Schema(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("robot", ctypes.c_char_p), ("rate", ctypes.c_double),
                ("vectors", ctypes.c_size_t), ("vector_names", ctypes.c_void_p), ("axis_counts", ctypes.c_void_p),
                ("axis_names", ctypes.c_void_p), ("cameras", ctypes.c_size_t), ("camera_names", ctypes.c_void_p)]


class Frames(ctypes.Structure):
    _fields_ = [("size", ctypes.c_size_t), ("instruction", ctypes.c_char_p), ("success", ctypes.c_int),
                ("steps", ctypes.c_size_t), *((name, ctypes.c_void_p) for name in (
                    "vectors", "pixels", "width", "height", "pictures", "picture_ends"))]


POINTER, TEXT, INT, SIZE = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_size_t
ERROR: List[Any] = [POINTER, SIZE]
# name: (result, arguments). Functions that can fail return an int and take ERROR last.
FUNCTIONS: Dict[str, Tuple[Any, List[Any]]] = {
    "version": (TEXT, []),
    "interface": (INT, []),
    "scenario_count": (SIZE, []),
    "scenario_name": (TEXT, [SIZE]),
    "scenario_title": (TEXT, [SIZE]),
    "scenario_deployed": (INT, [SIZE]),
    "options_default": (None, [POINTER]),
    "errors_new": (INT, [TEXT, INT, POINTER, POINTER, *ERROR]),
    "errors_add_effect": (INT, [POINTER, INT, TEXT, POINTER, SIZE, INT, *ERROR]),
    "errors_free": (None, [POINTER]),
    "errors_copy": (INT, [POINTER, POINTER, *ERROR]),
    "errors_restore": (INT, [POINTER, POINTER, *ERROR]),
    "errors_reads": (ctypes.c_uint, [POINTER]),
    "errors_reset": (INT, [POINTER, POINTER, POINTER, *ERROR]),
    "errors_attach": (INT, [POINTER, POINTER, POINTER, POINTER, POINTER, SIZE, *ERROR]),
    "errors_reset_attached": (INT, [POINTER, *ERROR]),
    "errors_act_attached": (INT, [POINTER, *ERROR]),
    "errors_recorded": (SIZE, [POINTER]),
    "errors_begin_control_step": (None, [POINTER, INT, INT]),
    "errors_torque": (INT, [POINTER, POINTER, POINTER, POINTER, *ERROR]),
    "errors_offset_change": (INT, [POINTER, POINTER, POINTER, *ERROR]),
    "errors_sub_step": (INT, [POINTER, POINTER, POINTER, POINTER, POINTER, *ERROR]),
    "errors_offset": (None, [POINTER, POINTER]),
    "errors_reading": (None, [POINTER, POINTER, POINTER, POINTER, POINTER]),
    "control_default": (None, [POINTER]),
    "compensator_new": (INT, [TEXT, POINTER, SIZE, POINTER, POINTER, *ERROR]),
    "compensator_free": (None, [POINTER]),
    "compensator_copy": (INT, [POINTER, POINTER, *ERROR]),
    "compensator_restore": (INT, [POINTER, POINTER, *ERROR]),
    "compensator_every_step": (INT, [POINTER]),
    "compensator_start_episode": (None, [POINTER]),
    "compensator_correct": (INT, [POINTER, POINTER, SIZE, POINTER, *ERROR]),
    "compensator_next": (INT, [POINTER, POINTER, POINTER, *ERROR]),
    "compensator_executed": (INT, [POINTER, POINTER, *ERROR]),
    "compensator_correction": (None, [POINTER, POINTER]),
    "compensator_residual": (INT, [POINTER, POINTER, POINTER, *ERROR]),
    "stream_new": (INT, [TEXT, POINTER, *ERROR]),
    "stream_free": (None, [POINTER]),
    "stream_add_text": (None, [POINTER, TEXT]),
    "stream_add_number": (None, [POINTER, ctypes.c_int64]),
    "stream_uniform": (None, [POINTER, POINTER, SIZE]),
    "stream_normal": (None, [POINTER, POINTER, SIZE]),
    "stream_integers": (None, [POINTER, INT, POINTER, SIZE]),
    "dataset_open": (INT, [TEXT, POINTER, POINTER, *ERROR]),
    "dataset_append": (INT, [POINTER, POINTER, *ERROR]),
    "dataset_episodes": (SIZE, [POINTER]),
    "dataset_steps": (SIZE, [POINTER]),
    "dataset_free": (None, [POINTER]),
    "cpython_sub_step": (POINTER, []),
}
SLOW = ("dataset_open", "dataset_append", "dataset_free")


def load() -> Any:
    beside = pathlib.Path(__file__).with_name("librobostress.so.1")
    path = os.environ.get("ROBOSTRESS_LIBRARY") or str(beside)
    try:
        library = ctypes.PyDLL(path)  # its calls take microseconds: to give the interpreter away costs more
        slow = ctypes.CDLL(path)  # those that write files do give it away
    except OSError as fault:
        raise ImportError(f"{path}: {fault}; the wheel holds it, made on this machine by `pip wheel ./python`") from fault
    for name, (result, arguments) in FUNCTIONS.items():
        try:
            function = getattr(slow if name in SLOW else library, "robostress_" + name)
        except AttributeError as fault:
            raise ImportError(f"{path} has no robostress_{name}: it is of another version; install the wheel anew"
                              ) from fault
        function.restype, function.argtypes = result, arguments
        setattr(library, "robostress_" + name, function)
    if library.robostress_interface() < INTERFACE:
        raise ImportError(f"{path} has interface {library.robostress_interface()}, needed is {INTERFACE}; "
                          "install the wheel anew")
    return library


LIBRARY = load()
__version__: str = LIBRARY.robostress_version().decode()


class Failures:
    """Where a handle's functions write what went wrong."""

    def __init__(self) -> None:
        self._text = ctypes.create_string_buffer(ERROR_SIZE)
        self.arguments = (ctypes.addressof(self._text), ERROR_SIZE)

    def check(self, code: int) -> None:
        if code:
            raise KINDS.get(code, InternalError)(self._text.value.decode("utf-8", "replace"))


class Unshared:
    """The owner of a C handle: a copy of its attributes would use the handle beside it, and after it was freed."""

    _instead = "make another"

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError(f"{type(self).__name__} cannot be copied or pickled: {self._instead}")


class Copied(Unshared):
    """The same with copy(), which copies what the handle stands for."""

    _instead = "use copy(), and in another process make another"

    def __copy__(self) -> Any:
        return self.copy()  # type: ignore[attr-defined]

    def __deepcopy__(self, memo: Any) -> Any:
        return self.copy()  # type: ignore[attr-defined]


def integer(name: str, value: Any, least: int = -2**31, most: int = 2**31 - 1) -> int:
    """`value`, a whole number of Python or NumPy, least to most; those of C's int unless said otherwise."""
    try:
        whole = operator.index(value)
    except TypeError:
        raise InvalidArgument(f"{name} is {value!r}, must be a whole number") from None
    if not least <= whole <= most:
        raise InvalidArgument(f"{name} is {whole}, must be {least} to {most}")
    return whole


def array(name: str, values: Any, dtype: Any, *shape: int) -> np.ndarray:
    """`values` as the library reads them; -1: any length."""
    try:
        if np.iscomplexobj(values):  # NumPy takes the real parts
            raise TypeError("complex numbers have no place here")
        result = np.ascontiguousarray(values, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as fault:
        raise InvalidArgument(f"{name}: {fault}; must be numbers of shape {list(shape)}") from fault
    if result.ndim != len(shape) or any(n not in (-1, m) for n, m in zip(shape, result.shape)):
        wanted = ["any" if n == -1 else n for n in shape]
        raise InvalidArgument(f"{name} has shape {list(result.shape)}, must be {wanted}")
    return result


def number(name: str, value: Any) -> float:
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise InvalidArgument(f"{name} is {value!r}, must be a number")
    try:
        return float(value)
    except OverflowError:
        raise InvalidArgument(f"{name} is {value}, larger than any double") from None


def text(name: str, value: Any) -> bytes:
    """As the library reads it, which ends at a NUL."""
    if not isinstance(value, str):
        raise InvalidArgument(f"{name} is {value!r}, must be text")
    if "\0" in value:
        raise InvalidArgument(f"{name} is {value!r}: there is a NUL in it")
    try:
        return value.encode()
    except UnicodeEncodeError as fault:
        raise InvalidArgument(f"{name} is {value!r}: {fault.reason}") from fault


class Scenario(NamedTuple):
    name: str
    title: str
    deployed: bool  # one of the paper's seven


def scenarios() -> List[Scenario]:
    """The built-in scenarios."""
    return [Scenario(LIBRARY.robostress_scenario_name(i).decode(), LIBRARY.robostress_scenario_title(i).decode(),
                     bool(LIBRARY.robostress_scenario_deployed(i)))
            for i in range(LIBRARY.robostress_scenario_count())]
