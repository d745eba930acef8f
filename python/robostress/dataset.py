"""Episodes of any environment as a data set of LeRobot v3.0, with the errors that were on."""
from __future__ import annotations

import ctypes
import os
import struct
import threading
import weakref
import zlib
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np

from robostress._library import (
    LIBRARY, Failures, Frames, InvalidArgument, Schema, Unshared, WrongOrder, array, integer, number, text)
from robostress.compensation import Compensator

ACTION = ("x", "y", "z", "rx", "ry", "rz", "gripper")
MOST_SIDE = 4096


def measured(before: Tuple[Any, Any], after: Tuple[Any, Any], sent: Any, *, translation_scale: float = 0.05,
             rotation_scale: float = 0.5) -> np.ndarray:
    """[7] the displacement that a command `sent` brought, in units of a command, and its gripper entry. before, after:
    position [m] and unit quaternion w x y z of the end effector. Zeros where no arm moves so far in a step: over 1 m, over
    2.5 rad."""
    compensator = Compensator("base", translation_scale=translation_scale, rotation_scale=rotation_scale)
    none, command = np.zeros((1, 7), np.float32), array("sent", sent, float, 7)
    if not np.isfinite(command).all():
        raise InvalidArgument(f"sent is {command.tolist()}, must be finite numbers")
    values = compensator.residual(*zip(_pose("before", before), _pose("after", after)), policy=none, sent=none)[0]
    values[6] = command[6]
    return values


def _pose(name: str, given: Any) -> Tuple[np.ndarray, np.ndarray]:
    try:
        position, orientation = given
    except (TypeError, ValueError):
        raise InvalidArgument(f"{name} is {given!r}, must be a position and a quaternion: ([3], [4])") from None
    return array(f"{name}'s position", position, float, 3), array(f"{name}'s quaternion", orientation, float, 4)


def _png(picture: np.ndarray) -> bytes:
    """An RGB picture [height, width, 3] as a PNG file (https://www.w3.org/TR/png-3)."""
    height, width, _ = picture.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)  # a row begins with its filter, 0: none
    rows[:, 1:] = picture.reshape(height, -1)
    chunks = ((b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
              (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks)


def _texts(names: Sequence[str]) -> Any:
    return (ctypes.c_char_p * len(names))(*(text("a name", name) for name in names))


class EpisodeDataset(Unshared):
    """A data set that grows by whole episodes, in a folder; opened again it goes on.

        with robostress.EpisodeDataset("data/worn", cameras=["image", "image2"]) as data:
            for each step:  data.add(state, {"image": ..., "image2": ...}, commanded=..., sent=..., measured=...)
            data.end("open the drawer", success)

    Columns: observation.state, action (commanded: what the policy asked for), action.sent (what the controller got),
    action.measured (what the arm did), observation.images.CAMERA. state, action: how many entries, or their names. more:
    further columns by name, given to add() as `more`. fps: steps a second. Pictures are RGB, uint8 [height, width, 3], of
    one size for each camera; they are kept as PNG. A process that dies loses the episode under way and no other. One recorder
    a folder; its methods may be called by several threads, and others go on while it writes.
    """

    _instead = "open the folder again when this one is closed"

    def __init__(self, folder: Union[str, "os.PathLike[str]"], *, fps: int = 20, robot: str = "panda",
                 state: Union[int, Sequence[str]] = 8, action: Union[int, Sequence[str]] = ACTION,
                 cameras: Sequence[str] = ("image", "image2"),
                 more: Optional[Mapping[str, Union[int, Sequence[str]]]] = None) -> None:
        columns = {"observation.state": state, "action": action, "action.sent": action, "action.measured": action}
        for name, axes in (more or {}).items():
            if name in columns or name in ("self", "state", "images", "commanded", "sent", "measured"):
                raise InvalidArgument(f"more has {name!r}, which is a column already, or what add() calls something else; rename it")
            columns[name] = axes
        if isinstance(cameras, str):
            raise InvalidArgument(f"cameras is {cameras!r}, must be a list of names: [{cameras!r}]")
        self._lock = threading.RLock()
        self._axes: Dict[str, List[str]] = {name: _names(name, axes) for name, axes in columns.items()}
        self.cameras, self._more = list(cameras), list(more or {})
        self._failures, handle = Failures(), ctypes.c_void_p()
        rows = [_texts(axes) for axes in self._axes.values()]
        keep = (_texts(list(self._axes)), (ctypes.c_size_t * len(rows))(*(len(row) for row in rows)),
                (ctypes.c_void_p * len(rows))(*(ctypes.addressof(row) for row in rows)), _texts(self.cameras))
        schema = Schema(ctypes.sizeof(Schema), text("robot", robot), number("fps", fps), len(rows), *map(ctypes.addressof, keep[:3]),
                        len(self.cameras), ctypes.addressof(keep[3]))
        if b"\0" in os.fsencode(folder):
            raise InvalidArgument(f"folder is {folder!r}: there is a NUL in it")
        self._failures.check(LIBRARY.robostress_dataset_open(
            os.fsencode(folder), ctypes.addressof(schema), ctypes.addressof(handle), *self._failures.arguments))
        self._handle = handle.value
        self._free = weakref.finalize(self, LIBRARY.robostress_dataset_free, self._handle)
        self.discard()

    def add(self, state: Any, images: Mapping[str, Any], *, commanded: Any, sent: Optional[Any] = None, measured: Any,
            **more: Any) -> None:
        """One step: what was seen before it, the command that was asked for, the one that was sent (None: the same), and
        what the arm did with it. more: the further columns, **{name: values}."""
        with self._lock:
            self._add(state, images, commanded, sent, measured, more)

    def _add(self, state: Any, images: Mapping[str, Any], commanded: Any, sent: Optional[Any], measured: Any,
             more: Mapping[str, Any]) -> None:
        self._check_open()
        if set(more) != set(self._more):
            raise InvalidArgument(f"columns {sorted(more)} are given, the set has {sorted(self._more)} beside its own")
        given = {"observation.state": state, "action": commanded, "action.sent": commanded if sent is None else sent,
                 "action.measured": measured, **more}
        row = {name: array(name, given[name], np.float32, len(axes)) for name, axes in self._axes.items()}
        for name, values in row.items():
            if not np.isfinite(values).all():
                raise InvalidArgument(f"{name} of step {len(self._taken)} is {values.tolist()}, must be finite numbers")
        if set(images) != set(self.cameras):
            raise InvalidArgument(f"pictures of {sorted(images)} are given, the set has cameras {sorted(self.cameras)}")
        pictures = {camera: self._picture(camera, images[camera]) for camera in self.cameras}
        self._taken.append(({name: values.copy() for name, values in row.items()}, pictures))

    def end(self, instruction: str, success: bool) -> int:
        """Writes the episode; returns its index."""
        with self._lock:
            return self._end(instruction, success)

    def _end(self, instruction: str, success: bool) -> int:
        self._check_open()
        if not self._taken:
            raise WrongOrder("the episode has no steps: add() some first")
        rows = [np.concatenate([row[name] for row, _ in self._taken]) for name in self._axes]
        pixels = [np.stack([pictures[camera] for _, pictures in self._taken]) for camera in self.cameras]
        files = [[_png(picture) for picture in of_camera] for of_camera in pixels]
        bytes_, ends = [b"".join(f) for f in files], [np.cumsum([len(p) for p in f], dtype=np.uintp) for f in files]
        sides = [(ctypes.c_int * len(pixels))(*(p.shape[i] for p in pixels)) for i in (2, 1)]
        pointers = [(ctypes.c_void_p * len(group))(*group) for group in (
            [r.ctypes.data for r in rows], [p.ctypes.data for p in pixels],
            [ctypes.cast(ctypes.c_char_p(b), ctypes.c_void_p).value for b in bytes_], [e.ctypes.data for e in ends])]
        vectors, pixels_at, pictures, picture_ends = map(ctypes.addressof, pointers)
        frames = Frames(ctypes.sizeof(Frames), text("instruction", instruction), bool(success), len(self._taken), vectors,
                        pixels_at, *map(ctypes.addressof, sides), pictures, picture_ends)
        index = self.episodes
        try:
            self._failures.check(LIBRARY.robostress_dataset_append(self._handle, ctypes.addressof(frames),
                                                                   *self._failures.arguments))
        finally:
            if self.episodes > index:  # Ctrl-C may come when it was written
                self.discard()
        return index

    def discard(self) -> None:
        """Forgets the episode under way."""
        with self._lock:
            # Of each step: a row of every column, a picture of every camera.
            self._taken: List[Tuple[Dict[str, np.ndarray], Dict[str, np.ndarray]]] = []

    @property
    def episodes(self) -> int:
        with self._lock:
            self._check_open()
            return int(LIBRARY.robostress_dataset_episodes(self._handle))

    @property
    def steps(self) -> int:
        """Of all episodes."""
        with self._lock:
            self._check_open()
            return int(LIBRARY.robostress_dataset_steps(self._handle))

    def close(self) -> None:
        """Once more does nothing. An episode under way is lost."""
        with self._lock:
            self._free()
            self._handle = None

    def __enter__(self) -> "EpisodeDataset":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._handle is None:
            raise WrongOrder("the data set is closed: open it again")

    def _picture(self, camera: str, given: Any) -> np.ndarray:
        picture = np.asarray(given)
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not (
                0 < min(picture.shape[:2]) and max(picture.shape[:2]) <= MOST_SIDE):
            raise InvalidArgument(f"picture of '{camera}' is {picture.dtype} {list(picture.shape)}, must be uint8 [height, "
                                  f"width, 3], 1 to {MOST_SIDE} pixels a side")
        first = self._taken[0][1][camera].shape if self._taken else picture.shape
        if first != picture.shape:
            raise InvalidArgument(f"picture of '{camera}' is {list(picture.shape)}, the episode's first was {list(first)}")
        return np.array(picture, order="C")  # a transposed one keeps its strides otherwise


def _names(column: str, axes: Union[int, Sequence[str]]) -> List[str]:
    if isinstance(axes, str) or not hasattr(axes, "__iter__"):
        axes = integer(f"column {column}", axes, 1)
    names = [f"{i}" for i in range(axes)] if isinstance(axes, int) else [str(name) for name in axes]
    if not names:
        raise InvalidArgument(f"column {column} has no entries")
    return names
