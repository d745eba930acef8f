"""The wire of deploy/robostress_serve_lerobot.py, without LeRobot: a policy of its own, and bad clients.

    serve_lerobot_driver.py serve OPTIONS ...     the file's server around a policy that counts, see Counting
    serve_lerobot_driver.py ask PORT KEY          openpi's own client, five times, of whatever policy is served
    serve_lerobot_driver.py attack PORT KEY       clients that an open port meets; exit code 0: it stood

Runs where openpi's client is installed.
"""

import argparse
import concurrent.futures
import http.client
import os
import random
import sys
import time

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "deploy"))

import numpy as np
import robostress_serve_lerobot as file
import websockets
from openpi_client import msgpack_numpy, websocket_client_policy
from websockets.sync.client import connect


class Counting:
    """actions[i, j] = state[j] + i for 10 rows and 7 columns. Column 3 is the seed, or -1; column 4 the
    episodes; columns 5 and 6 the first red of the two views. Some prompts make it fail."""

    def __init__(self, options):
        self.exclusive = options.every_step
        cameras = [file.Camera("observation.images.image", 224, 224), file.Camera("observation.images.image2", 224, 224)]
        self.reader = file.ObservationReader(cameras, 8, True, turn=options.turn)
        self.episodes = 0
        self.metadata = {"server": "counting", "extensions": ["reset", "seed"],
                         "policies": [{"name": "counting", "action_dim": 7, "action_horizon": 10}]}

    def reset(self, client):
        self.episodes += 1

    def forget(self, client):
        pass

    def infer(self, message, seed, client):
        views, state, task = self.reader.read(message)
        if task == "fail":
            return {}["no such weight"]
        if task == "sleep":
            time.sleep(1.5)
        actions = np.resize(state, 7)[None, :] + np.arange(10, dtype=np.float32)[:, None]
        actions[:, 3] = -1 if seed is None else seed
        actions[:, 4] = self.episodes
        actions[:, 5:] = [view[0, 0, 0] for view in views.values()]
        if task == "nan":
            actions[2, 1] = np.nan
        return actions


def observation(prompt="do something"):
    image = np.zeros((224, 224, 3), np.uint8)
    return {"observation/image": image, "observation/wrist_image": image, "observation/state": np.ones(8),
            "prompt": prompt}


def get(port, path):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10)
    connection.request("GET", path)
    return connection.getresponse()


def ask(port, key):
    client = websocket_client_policy.WebsocketClientPolicy(host="127.0.0.1", port=port, api_key=key)
    declared, slowest_ms = client.get_server_metadata()["policies"][0], 0
    for step in range(5):
        begin = time.monotonic()
        reply = client.infer(observation() | {"seed": step})
        slowest_ms = max(slowest_ms, 1e3 * (time.monotonic() - begin))
        actions = reply["actions"]
        assert actions.dtype == np.float32 and np.isfinite(actions).all(), actions
        assert actions.shape == (declared["action_horizon"], declared["action_dim"]), (actions.shape, declared)
        assert ("prev_total_ms" in reply["server_timing"]) == (step > 0)
        assert all(value > 0 for value in reply["policy_timing"].values())
    print("served", step + 1, "chunks of", actions.shape, "slowest", round(slowest_ms, 1), "ms")


def attack(port, key):
    url, header = f"ws://127.0.0.1:{port}", {"Authorization": f"Api-Key {key}"}
    packer = msgpack_numpy.Packer()

    def dial(**options):
        socket = connect(url, additional_headers=header, compression=None, max_size=None, **options)
        msgpack_numpy.unpackb(socket.recv())
        return socket

    def last_words(message):
        """What the server says to a message, before it ends the connection, and with which code."""
        with dial() as socket:
            socket.send(message)
            try:
                said = socket.recv(timeout=20)
                assert isinstance(said, str), f"{message[:40]!r} was answered"
                socket.recv(timeout=20)
            except websockets.ConnectionClosed as closed:
                return said, closed.rcvd.code
        raise AssertionError("the connection lives on")

    def works():
        with dial() as socket:
            socket.send(packer.pack(observation()))
            assert msgpack_numpy.unpackb(socket.recv(timeout=20))["actions"].shape == (10, 7)

    # Who may ask.
    for headers in ({}, {"Authorization": "Api-Key wrong"}, {"Authorization": f"Bearer {key}"}):
        try:
            connect(url, additional_headers=headers)
            raise AssertionError(f"{headers} got in")
        except websockets.InvalidStatus as refused:
            assert refused.response.status_code == 401, refused.response
    try:
        dial(origin="http://a.page")
        raise AssertionError("a browser's page got in")
    except websockets.InvalidStatus as refused:
        assert refused.response.status_code == 403, refused.response
    assert get(port, "/healthz").read() == b"OK\n"

    # What is no message.
    whole = packer.pack(observation())
    array = {b"__ndarray__": True, b"data": b"12345678", b"dtype": "<f4", b"shape": [2]}
    with_array = lambda **changes: packer.pack({"observation/state": array | {k.encode(): v for k, v in changes.items()}})
    for message, words in [
        ("hello", "binary msgpack"),
        (b"", "is no msgpack"),
        (whole[:-1], "is no msgpack"),
        (whole + b"\0", "is no msgpack"),
        (b"\xc1", "is no msgpack"),
        (packer.pack([1, 2]), "a message is a map; a list came"),
        (b"\x81" * 2000, "is no msgpack"),
        (b"\xdf\xff\xff\xff\xff", "is no msgpack"),
        (with_array(dtype="|O"), "dtype is '|O'"),
        (with_array(dtype="<M8[s]"), "dtype is '<M8[s]'"),
        (with_array(dtype="no type"), "dtype is 'no type'"),
        (with_array(dtype=7), "dtype is 7"),
        (with_array(shape=[3]), "an array [3] of float32 has 12 bytes, 8 came"),
        (with_array(shape=[-1, 2]), "cannot have the shape"),
        (with_array(shape=[2**62, 4]), "cannot have the shape"),
        (with_array(shape=[1] * 100), "at most 8 numbers"),
        (with_array(shape="2"), "at most 8 numbers"),
        (with_array(data="12345678"), "data as bytes"),
        (packer.pack(observation() | {"seed": -1}), "seed: is -1, must be a whole number from 0 to 2^63 - 1"),
        (packer.pack(observation() | {"seed": 2**63}), "seed: is 9223372036854775808"),
        (packer.pack(observation() | {"seed": 0.5}), "seed: is 0.5"),
        (packer.pack(observation() | {"seed": True}), "seed: is True"),
        (packer.pack(observation() | {"reset": 1}), "reset: is 1, must be true or false"),
        (packer.pack(observation() | {"prompt": 5}), "prompt: is int, must be text"),
        (packer.pack({"\x1b[2J\nkey": 1}), "message holds ?[2J key. Looked"),
        (b"\x81\xa1a" * 900 + b"\xc0", "The message holds a/a/a/a. Looked"),
    ]:
        said, code = last_words(message)
        assert words in said and code == 1011, (message[:60], said, code)
        assert "\n" not in said and len(said) <= 4000, said

    # What is too long is not read.
    with dial() as socket:
        try:
            socket.send(bytes(3 << 20))
            socket.recv(timeout=20)
            raise AssertionError("3 MiB were read where 2 are the limit")
        except websockets.ConnectionClosed as closed:
            assert closed.rcvd.code == 1009, closed

    # A valid message, broken anywhere, is answered in words or in actions, and the next client is served.
    generator = random.Random(7)
    small = observation() | {"observation/image": np.zeros((2, 2, 3), np.uint8), "observation/wrist_image": np.zeros((2, 2, 3), np.uint8)}
    small = packer.pack(small)
    for _ in range(300):
        broken = bytearray(small)
        for _ in range(generator.randint(1, 4)):
            broken[generator.randrange(len(broken))] = generator.randrange(256)
        said, code = last_words(bytes(broken[: generator.choice([len(broken), generator.randrange(len(broken))])]))
        assert code == 1011, (said, code)
    works()

    # While the policy thinks, pings and /healthz are answered, and nobody's answer is lost.
    def slow():
        with dial(ping_interval=0.2, ping_timeout=0.5) as socket:
            socket.send(packer.pack(observation("sleep")))
            return msgpack_numpy.unpackb(socket.recv(timeout=20))["actions"].shape

    with concurrent.futures.ThreadPoolExecutor(1) as pool:
        answer = pool.submit(slow)
        time.sleep(0.5)
        begin = time.monotonic()
        assert get(port, "/healthz").status == 200
        assert time.monotonic() - begin < 0.5, "/healthz waited for the policy"
        assert answer.result() == (10, 7)

    # A crowd: four places, and the fifth is told so.
    places = [dial() for _ in range(4)]
    with connect(url, additional_headers=header) as socket:
        assert socket.recv() == "this server takes 4 clients at a time: try again later"
    for place in places:
        place.close()
    for _ in range(50):  # the server counts them out when it notices
        try:
            works()
            break
        except Exception:
            time.sleep(0.1)
    works()

    ask(port, key)
    print("stood")


if __name__ == "__main__":
    if sys.argv[1] in ("ask", "attack"):
        {"ask": ask, "attack": attack}[sys.argv[1]](int(sys.argv[2]), sys.argv[3])
    else:
        parser = argparse.ArgumentParser()
        parser.add_argument("--every-step", action="store_true")
        parser.add_argument("--turn", default="none")
        file.add_server_options(parser)
        sys.exit(file.run(Counting, parser.parse_args(sys.argv[2:])))
