"""A client of `robostress serve` and of every server that speaks openpi's WebSocket wire. Needs robostress[client]."""
from __future__ import annotations

from typing import Any, Dict, Mapping, Optional

import numpy as np

from robostress._library import NotFound, RobostressError


class ServerError(RobostressError):
    """What the server refused, in its words; the connection is over."""


def _packed(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.ascontiguousarray(value)
        if array.dtype.kind in "OVc":
            raise TypeError(f"arrays of {array.dtype} have no form on this wire; send numbers")
        return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}
    raise TypeError(f"{type(value).__name__} has no form on this wire; send numbers, text, arrays and maps of them")


def _unpacked(value: Dict[Any, Any]) -> Any:
    keys = {key.decode() if isinstance(key, bytes) else key: item for key, item in value.items()}
    if "__ndarray__" in keys:
        return np.frombuffer(keys["data"], np.dtype(keys["dtype"])).reshape(keys["shape"])
    if "__npgeneric__" in keys:
        return np.dtype(keys["dtype"]).type(keys["data"])
    return value


class PolicyClient:
    """One robot at a server. metadata: what the server greets with.

        with PolicyClient("ws://127.0.0.1:8000", method="ours") as client:
            reply = client.infer({"observation/image": ..., "observation/state": ..., "prompt": ...}, reset=True)
            reply["actions"]                                            # [horizon, action_dim]
            client.infer(observation, executed={"p_base_tool": ..., ...})  # with what the arm did

    method, method_options and the keys of `session` are of a RoboStress server, as is `executed`; others ignore them.
    """

    def __init__(self, uri: str, *, method: Optional[str] = None, method_options: Any = (),
                 session: Optional[Mapping[str, Any]] = None, token: Optional[str] = None,
                 open_timeout: float = 10, timeout: float = 120) -> None:
        try:
            import msgpack  # type: ignore[import-untyped]
            from websockets.sync.client import connect
        except ImportError as fault:
            raise NotFound(f"{fault.name} is not installed: pip install 'robostress[client]'") from fault
        self._msgpack, self._timeout = msgpack, timeout
        self._session = dict(session or {})
        if method is not None:
            self._session.update(method=method, method_options=list(method_options))
        headers = {"Authorization": f"Api-Key {token}"} if token else None
        self._socket = connect(uri, compression=None, max_size=None, additional_headers=headers,
                               open_timeout=open_timeout)
        self.metadata: Dict[str, Any] = self._receive()

    def infer(self, observation: Mapping[str, Any], *, reset: bool = False,
              executed: Optional[Mapping[str, Any]] = None) -> Dict[str, Any]:
        """The server's reply to an observation with its prompt. reset: a new episode. executed: q, p_base_tool, q_base_tool,
        gripper of [n + 1] states, prediction_id, first_step, sequence (docs/results/server-wires.md)."""
        message = dict(observation)
        if self._session:
            message["session"] = self._session
            self._session = {}
        if reset:
            message["reset"] = True
        if executed is not None:
            message["executed"] = dict(executed)
        self._socket.send(self._msgpack.packb(message, default=_packed))
        return self._receive()

    def report(self, executed: Mapping[str, Any]) -> Dict[str, Any]:
        """`executed` alone, as at the end of an episode."""
        return self.infer({}, executed=executed)

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> "PolicyClient":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _receive(self) -> Dict[str, Any]:
        frame = self._socket.recv(timeout=self._timeout)
        if isinstance(frame, str):
            self.close()
            raise ServerError(frame)
        return self._msgpack.unpackb(frame, object_hook=_unpacked, strict_map_key=False)
