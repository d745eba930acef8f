"""Random streams: a draw depends on the parts of the key and on its index alone."""
from __future__ import annotations

import ctypes
import weakref
from typing import Union

import numpy as np

from robostress._library import LIBRARY, Failures, InvalidArgument, Unshared, integer, text

MOST = 2**40  # draws at once


class Stream(Unshared):
    """Draws of a purpose ("camera noise"), made its own by further parts: names and integers."""

    _instead = "make one of the same purpose and parts where it is needed; it draws the same from its beginning"

    def __init__(self, purpose: str, *parts: Union[str, int]) -> None:
        failures, handle = Failures(), ctypes.c_void_p()
        failures.check(LIBRARY.robostress_stream_new(text("purpose", purpose), ctypes.addressof(handle), *failures.arguments))
        self._handle = handle.value
        weakref.finalize(self, LIBRARY.robostress_stream_free, self._handle)
        for part in parts:
            if isinstance(part, str):
                LIBRARY.robostress_stream_add_text(self._handle, text("a part", part))
            elif isinstance(part, (int, np.integer)) and -2**63 <= part < 2**63:
                LIBRARY.robostress_stream_add_number(self._handle, int(part))
            else:
                raise InvalidArgument(f"part {part!r} of the key is no text and no integer of 64 bits")

    def uniform(self, count: int) -> np.ndarray:
        """[count] in [0, 1)."""
        return self._draw(LIBRARY.robostress_stream_uniform, count)

    def normal(self, count: int) -> np.ndarray:
        """[count] of N(0, 1)."""
        return self._draw(LIBRARY.robostress_stream_normal, count)

    def integers(self, n: int, count: int) -> np.ndarray:
        """[count] of 0 to n - 1."""
        n, count = integer("n", n, 1), integer("count", count, 0, MOST)
        values = np.empty(count, dtype=np.intc)
        LIBRARY.robostress_stream_integers(self._handle, n, values.ctypes.data, count)
        return values

    def _draw(self, function, count: int) -> np.ndarray:
        count = integer("count", count, 0, MOST)
        values = np.empty(count)
        function(self._handle, values.ctypes.data, count)
        return values
