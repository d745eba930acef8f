#!/usr/bin/env python3
"""The policy client against a server in this process, over loopback: what becomes of it when an exchange goes wrong."""
import sys
import threading
import time
import unittest
import unittest.mock

import numpy as np

import robostress as rs

try:
    import msgpack
    from websockets.sync import client as websockets_client
    from websockets.sync.server import serve
except ImportError as fault:
    print(f"SKIPPED: {fault.name} could not be had from PyPI")
    sys.exit(77)


class Server:
    """Answers message n with n, that with "late" after a second; hangs up at "leave"."""

    def __init__(self):
        self.seen = []
        self._server = serve(self._talk, "127.0.0.1", 0, compression=None)
        self.uri = f"ws://127.0.0.1:{self._server.socket.getsockname()[1]}"
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()

    def _talk(self, connection):
        connection.send(msgpack.packb({"hello": 1}))
        for frame in connection:
            message = msgpack.unpackb(frame)
            self.seen.append(message)
            if message.get("late"):
                time.sleep(1)
            if message.get("leave"):
                return
            connection.send(msgpack.packb({"answer_to": message["n"]}))

    def close(self):
        self._server.shutdown()
        self._thread.join()


class Clients(unittest.TestCase):
    def setUp(self):
        self.server = Server()
        self.addCleanup(self.server.close)

    def client(self, **more):
        client = rs.PolicyClient(self.server.uri, **more)
        self.addCleanup(client.close)
        return client

    def test_a_late_answer_is_never_taken_for_the_next_ones(self):
        client = self.client(timeout=0.2)
        with self.assertRaisesRegex(rs.RobostressError, "no answer in 0.2 s: .*timeout=, and make another client") as caught:
            client.infer({"n": 0, "late": True})
        self.assertIsInstance(caught.exception, TimeoutError)
        time.sleep(1.2)
        with self.assertRaisesRegex(rs.RobostressError, "the connection is over .*: make another client"):
            client.infer({"n": 1})
        self.assertEqual(self.client().infer({"n": 2}), {"answer_to": 2})

    def test_an_interrupted_exchange_ends_the_connection(self):
        client = self.client()
        with unittest.mock.patch.object(client._socket, "recv", side_effect=KeyboardInterrupt):
            with self.assertRaises(KeyboardInterrupt):
                client.infer({"n": 0})
        with self.assertRaisesRegex(rs.RobostressError, "make another client"):
            client.infer({"n": 1})

    def test_what_cannot_be_packed_keeps_session_and_connection(self):
        client = self.client(method="ours_following", session={"robot": "arm"})
        with self.assertRaisesRegex(TypeError, "object has no form on this wire"):
            client.infer({"n": 0, "image": object()})
        self.assertEqual(client.infer({"n": 1}), {"answer_to": 1})
        self.assertEqual(self.server.seen[0]["session"], {"robot": "arm", "method": "ours_following", "method_options": []})
        client.infer({"n": 2})
        self.assertNotIn("session", self.server.seen[1])

    def test_a_server_that_goes_is_said(self):
        with self.assertRaisesRegex(rs.RobostressError, "the connection is over"):
            self.client().infer({"n": 0, "leave": True})

    def test_a_server_that_is_not_there_is_said(self):
        with self.assertRaisesRegex(rs.RobostressError, "no policy server answers at ws://127.0.0.1:1 .*start it, or give") as told:
            rs.PolicyClient("ws://127.0.0.1:1")
        self.assertIsInstance(told.exception, ConnectionError)

    def test_threads_wait_for_each_other(self):
        client, answers = self.client(), []
        threads = [threading.Thread(target=lambda n=n: answers.append((n, client.infer({"n": n})))) for n in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(sorted(answers), [(n, {"answer_to": n}) for n in range(8)])

    def test_arrays_keep_their_shape_on_the_wire(self):
        grid = np.arange(6.0).reshape(2, 3)
        self.client().infer({"n": 0, "point": np.array(3.0), "number": np.float32(3), "turned": grid.T})
        seen = self.server.seen[0]
        self.assertEqual(seen["point"][b"shape"], [])
        self.assertEqual(seen["number"], {b"__npgeneric__": True, b"data": 3.0, b"dtype": "<f4"})
        self.assertEqual((seen["turned"][b"shape"], seen["turned"][b"data"]), ([3, 2], grid.T.tobytes()))

    def test_no_pings_which_a_server_that_computes_does_not_answer(self):
        real = websockets_client.connect
        given = {}

        def with_pings(uri, *, ping_interval=20, **more):
            given.update(ping_interval=ping_interval)
            return real(uri, **more)

        def without_pings(uri, *, compression, max_size, additional_headers, open_timeout, close_timeout):
            return real(uri, compression=compression, open_timeout=open_timeout)

        for connect in (with_pings, without_pings):
            with unittest.mock.patch.object(websockets_client, "connect", connect):
                self.assertEqual(self.client().infer({"n": 4}), {"answer_to": 4})
        self.assertEqual(given, {"ping_interval": None})


unittest.main(verbosity=1)
