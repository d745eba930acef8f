"""A client of `robostress serve` and of every server that speaks openpi's WebSocket wire. Needs robostress[client]."""
from __future__ import annotations

import inspect
import ssl
import threading
from typing import Any, Dict, Mapping, Optional

import numpy as np

from robostress._library import NotFound, RobostressError


class ServerError(RobostressError):
    """What the server refused, in its words, or that it is gone; the connection is over."""


class NotThere(ServerError, ConnectionError):
    """Nobody answers at the address."""


class NoAnswer(ServerError, TimeoutError):
    """The server took longer than `timeout`; the connection is over."""


def _packed(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        if value.dtype.kind in "OVc":
            raise TypeError(f"arrays of {value.dtype} have no form on this wire; send numbers")
        if isinstance(value, np.generic):
            return {b"__npgeneric__": True, b"data": value.item(), b"dtype": value.dtype.str}
        return {b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str, b"shape": value.shape}
    raise TypeError(f"{type(value).__name__} has no form on this wire; send numbers, text, arrays and maps of them")


def _unpacked(value: Dict[Any, Any]) -> Any:
    keys = {key.decode() if isinstance(key, bytes) else key: item for key, item in value.items()}
    if "__ndarray__" in keys:
        return np.frombuffer(keys["data"], np.dtype(keys["dtype"])).reshape(keys["shape"])
    if "__npgeneric__" in keys:
        return np.dtype(keys["dtype"]).type(keys["data"])
    return value


class PolicyClient:
    """One robot at a server; threads wait for each other. metadata: what the server greets with.

        with PolicyClient("ws://127.0.0.1:8000", method="ours") as client:
            reply = client.infer({"observation/image": ..., "observation/state": ..., "prompt": ...}, reset=True)
            reply["actions"]                                            # [horizon, action_dim]
            client.infer(observation, executed={"p_base_tool": ..., ...})  # with what the arm did

    method, method_options and the keys of `session` are of a RoboStress server, as is `executed`; others ignore them. timeout:
    [s] for an answer. A timeout or Ctrl-C in infer() ends the connection, else its late answer would be taken for the next.
    """

    def __init__(self, uri: str, *, method: Optional[str] = None, method_options: Any = (),
                 session: Optional[Mapping[str, Any]] = None, token: Optional[str] = None,
                 open_timeout: float = 10, timeout: float = 120) -> None:
        try:
            import msgpack  # type: ignore[import-untyped]
            from websockets.exceptions import ConnectionClosed, WebSocketException
            from websockets.sync.client import connect
        except ImportError as fault:
            raise NotFound(f"{fault.name} is not installed: pip install 'robostress[client]'") from fault
        self._msgpack, self._timeout, self._over = msgpack, timeout, ConnectionClosed
        self._lock = threading.Lock()
        self._session = dict(session or {})
        if method is not None:
            self._session.update(method=method, method_options=list(method_options))
        headers = {"Authorization": f"Api-Key {token}"} if token else None
        # A server that computes answers neither pings nor a farewell. Versions of websockets differ in what they take.
        known = inspect.signature(connect).parameters
        more: Dict[str, Any] = {"ping_interval": None, "legacy": True}
        more = {name: value for name, value in more.items() if name in known}
        try:
            self._socket = connect(uri, compression=None, max_size=None, additional_headers=headers,
                                   open_timeout=open_timeout, close_timeout=1, **more)
        except ssl.SSLError as fault:
            raise ServerError(f"{uri}: {fault}; give ws:// to a server without TLS, or trust its certificate") from fault
        except OSError as fault:
            raise NotThere(f"no policy server answers at {uri} ({fault}): start it, or give its address") from fault
        except WebSocketException as fault:
            raise ServerError(f"{uri}: {fault}; give ws://HOST:PORT of a policy server, and its token if it asks for one"
                              ) from fault
        self.metadata: Dict[str, Any] = self._exchange(None)

    def infer(self, observation: Mapping[str, Any], *, reset: bool = False,
              executed: Optional[Mapping[str, Any]] = None) -> Dict[str, Any]:
        """The server's reply to an observation with its prompt. reset: a new episode. executed: q, p_base_tool, q_base_tool,
        gripper of [n + 1] states, prediction_id, first_step, sequence (docs/results/server-wires.md)."""
        message = dict(observation)
        if reset:
            message["reset"] = True
        if executed is not None:
            message["executed"] = dict(executed)
        with self._lock:
            if self._session:
                message["session"] = self._session
            reply = self._exchange(self._msgpack.packb(message, default=_packed))
            self._session = {}
        return reply

    def report(self, executed: Mapping[str, Any]) -> Dict[str, Any]:
        """`executed` alone, as at the end of an episode."""
        return self.infer({}, executed=executed)

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> "PolicyClient":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def _exchange(self, question: Optional[bytes]) -> Dict[str, Any]:
        try:
            if question is not None:
                self._socket.send(question)
            frame = self._socket.recv(timeout=self._timeout)
            if isinstance(frame, str):
                raise ServerError(frame)
            try:
                return self._msgpack.unpackb(frame, object_hook=_unpacked, strict_map_key=False)
            except Exception as fault:
                raise ServerError(f"the server's answer of {len(frame)} bytes is no msgpack map that openpi's wire knows "
                                  f"({type(fault).__name__} {fault}): is it a policy server?") from fault
        except BaseException as fault:
            self.close()
            if isinstance(fault, TimeoutError):
                raise NoAnswer(f"no answer in {self._timeout} s: give a longer timeout=, and make another client; this one's "
                               "connection is over") from None
            if isinstance(fault, self._over):
                raise ServerError(f"the connection is over ({fault}): make another client") from fault
            raise
