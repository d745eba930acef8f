#!/usr/bin/env python3
"""What a driver of deploy/robostress_bridge.py obeys, and what it leaves out."""

import json
import logging
import os
import socket
import struct
import sys
import tempfile
import time
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../deploy"))

import robostress_bridge as bridge

logging.disable(logging.CRITICAL)
bridge.OLDEST_COMMAND_NS = 2 * 10**9  # a busy machine makes a command of 0.1 s


class Noted(bridge.Arm):
    axes, can_power_off = ("a", "b"), True

    def __init__(self):
        self.calls, self.at, self.broken = [], [1.0, 2.0], False
        self.deaf = 0  # so many orders raise
        self.age_ns, self.effort, self.on, self.closed = 0, None, True, False

    def read(self):
        if self.broken:
            raise RuntimeError("no answer")
        return time.monotonic_ns() - self.age_ns, list(self.at), None, None, 0

    def listens(self):
        self.deaf -= 1
        if self.deaf >= 0:
            raise RuntimeError("a lost packet")

    def move(self, targets, gripper_effort):
        self.listens()
        self.calls.append(("move", targets))
        self.effort = gripper_effort

    def power_off(self):
        self.listens()
        self.calls.append(("power_off",))

    def powered(self):
        return self.on

    def close(self):
        self.closed = True


class DriverRules(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory()
        self.addCleanup(self.folder.cleanup)
        self.path = os.path.join(self.folder.name, "arm")
        self.arm = Noted()
        self.session = bridge.Session(self.arm, self.path, 100.0, 30.0, "hold")
        self.addCleanup(lambda: (self.session.listener.close(), self.session.client and self.session.client.close()))
        self.sequence = 0
        self.client = self.dial()

    def dial(self):
        client = socket.socket(socket.AF_UNIX)
        client.connect(self.path)
        client.setblocking(False)
        self.addCleanup(client.close)
        self.step()
        return client

    def step(self, states=False):
        self.session.step(time.monotonic() - (1 if states else -0.005))

    def frame(self, kind, payload, sequence=None, version=1, magic=b"RSBR"):
        if sequence is None:
            self.sequence += 1
            sequence = self.sequence
        self.client.send(bridge.HEADER.pack(magic, version, kind, len(payload), sequence) + payload)
        self.step()

    def hello(self, axes=("b", "a"), protocol=1, gripper=None):
        self.frame(bridge.HELLO, json.dumps({"protocol": protocol, "axes": axes, "gripper": gripper}).encode())

    def command(self, mode, targets=(5.0, 6.0), age_s=0.0, sequence=None):
        head = bridge.COMMAND.pack(time.monotonic_ns() - int(age_s * 1e9), 0, mode, 0, 0.5)
        self.frame(bridge.COMMAND_KIND, head + struct.pack(f"<{len(targets)}d", *targets), sequence)

    def enabled(self, gripper=None):
        self.hello(gripper=gripper)
        self.command(bridge.ENABLE)
        self.arm.calls.clear()

    def answer(self):
        """(kind, payload) of the last frame that came; None: hung up."""
        data, last = self.client.recv(1 << 16), None
        while data:
            _, _, kind, size, _ = bridge.HEADER.unpack_from(data)
            last, data = (kind, data[16 : 16 + size]), data[16 + size :]
        return last

    def test_targets_are_obeyed_in_the_clients_order_of_names(self):
        self.enabled()
        self.command(bridge.TARGET, (5.0, 6.0))
        self.assertEqual(self.arm.calls, [("move", [6.0, 5.0])])

    def test_nothing_is_obeyed_before_enable(self):
        self.hello()
        self.command(bridge.TARGET)
        self.assertEqual(self.arm.calls, [])

    def test_old_repeated_and_infinite_targets_are_left_out(self):
        self.enabled()
        self.command(bridge.TARGET, age_s=5)
        self.command(bridge.TARGET, age_s=-5)
        self.command(bridge.TARGET, sequence=self.sequence - 1)
        self.command(bridge.TARGET, (float("nan"), 1.0))
        self.command(bridge.TARGET, (float("inf"), 1.0))
        self.assertEqual(self.arm.calls, [])
        self.command(bridge.TARGET, sequence=1000)
        self.assertEqual(len(self.arm.calls), 1)

    def test_of_several_targets_the_newest_is_obeyed(self):
        self.enabled()
        for value in (1.0, 2.0, 3.0):
            self.sequence += 1
            payload = bridge.COMMAND.pack(time.monotonic_ns(), 0, bridge.TARGET, 0, 0.5) + struct.pack("<2d", value, 0)
            self.client.send(bridge.HEADER.pack(b"RSBR", 1, 5, len(payload), self.sequence) + payload)
        self.step()
        self.assertEqual(self.arm.calls, [("move", [0.0, 3.0])])

    def test_a_stop_is_obeyed_however_old_and_once(self):
        self.enabled()
        self.command(bridge.STOP, age_s=5)
        self.command(bridge.STOP, age_s=5)
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])], "where it stands")
        self.command(bridge.TARGET)
        self.assertEqual(len(self.arm.calls), 1)
        self.assertEqual(self.session.flags, bridge.STOPPED)
        self.command(bridge.ENABLE)
        self.command(bridge.TARGET)
        self.assertEqual(self.arm.calls[-1], ("move", [6.0, 5.0]))

    def test_power_off_is_obeyed_however_old(self):
        self.enabled()
        self.command(bridge.POWER_OFF, age_s=5)
        self.assertEqual(self.arm.calls, [("power_off",)])

    def test_a_silent_client_is_held_once_and_its_targets_are_obeyed_no_more(self):
        self.enabled()
        self.session.watchdog_s = 0.1
        time.sleep(0.12)
        self.step()
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])])
        self.command(bridge.TARGET)
        self.step()
        self.assertEqual(len(self.arm.calls), 1)
        self.assertEqual(self.session.flags, bridge.HELD)

    def test_a_hold_that_the_arm_does_not_obey_is_told_again_and_not_reported_before(self):
        for on_silence, done in (("hold", ("move", [1.0, 2.0])), ("stop", ("move", [1.0, 2.0])),
                                 ("torque_off", ("power_off",))):
            self.enabled()
            self.session.on_silence, self.session.watchdog_s, self.arm.deaf = on_silence, 0.0, 3
            self.step()
            self.assertEqual((self.arm.calls, self.session.flags), ([], 0), on_silence)
            self.assertTrue(self.session.failed & bridge.FAULT_DRIVER)
            for _ in range(2):
                self.step(states=True)
            self.assertEqual((self.arm.calls, self.session.flags), ([], 0), on_silence)
            for _ in range(2):
                self.step(states=True)
            self.assertEqual((self.arm.calls, self.session.flags), ([done], bridge.HELD), on_silence)
            self.session.watchdog_s = 30.0
            self.client.close()
            self.client, self.sequence = self.dial(), 0

    def test_a_stop_that_the_arm_does_not_obey_is_told_again_after_the_client_has_gone(self):
        self.enabled()
        self.arm.deaf = 1
        self.command(bridge.STOP)
        self.assertEqual((self.arm.calls, self.session.flags), ([], 0))
        self.client.close()
        for _ in range(3):
            self.step(states=True)
        self.assertEqual((self.arm.calls, self.session.flags), ([("move", [1.0, 2.0])], bridge.STOPPED))

    def test_an_enable_ends_what_the_arm_was_told_on_silence(self):
        self.enabled()
        self.session.watchdog_s, self.arm.deaf = 0.0, 1
        self.step()
        self.session.watchdog_s = 30.0
        self.command(bridge.ENABLE)
        self.arm.calls.clear()
        self.step(states=True)
        self.assertEqual((self.arm.calls, self.session.flags), ([], bridge.TAKING))

    def test_a_power_off_that_failed_leaves_the_arm_watched(self):
        self.enabled()
        self.arm.deaf = 1
        self.command(bridge.POWER_OFF)
        self.client.close()
        self.step()
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])])

    def test_an_arm_that_cannot_be_read_holds_where_it_last_stood(self):
        nan = float("nan")
        for broken, at in ((True, [1.0, 2.0]), (False, [nan, 2.0])):
            self.enabled()
            self.command(bridge.TARGET, (2.1, 1.1))
            self.step(states=True)
            self.arm.broken, self.arm.at = broken, at
            self.session.silent("gone")
            self.assertEqual(self.arm.calls[-1], ("move", [1.0, 2.0]))
            self.arm.broken, self.arm.at = False, [1.0, 2.0]
            self.client.close()
            self.client, self.sequence = self.dial(), 0

    def test_an_old_reading_does_not_lead_the_arm_back(self):
        self.enabled()
        self.arm.age_ns = 10**9
        self.command(bridge.TARGET, (5.0, 6.0))
        self.session.silent("gone")
        self.assertEqual(self.arm.calls, [("move", [6.0, 5.0])] * 2)

    def test_nothing_is_enabled_that_cannot_be_read(self):
        self.enabled()
        self.command(bridge.TARGET)
        self.command(bridge.STOP)
        self.arm.age_ns = 10**9
        self.command(bridge.ENABLE)
        self.assertFalse(self.session.flags & bridge.TAKING)

    def test_a_gripper_keeps_what_it_was_told_while_the_joints_hold_where_they_stand(self):
        for end in (lambda: self.session.silent("gone"), lambda: self.command(bridge.STOP),
                    lambda: self.command(bridge.ENABLE)):
            self.enabled(gripper="b")
            self.command(bridge.TARGET, (0.0, 1.1))
            end()
            self.assertEqual((self.arm.calls[-1], self.arm.effort), (("move", [1.0, 0.0]), 0.5))
            self.client.close()
            self.client, self.sequence = self.dial(), 0

    def test_limp_fingers_and_those_that_nobody_watched_do_not_close_again(self):
        def limp():
            self.arm.on = False
            self.step(states=True)
            self.arm.on = True

        def left():
            self.client.close()
            self.client, self.sequence = self.dial(), 0
            self.hello(gripper="b")

        for happens in (limp, lambda: self.command(bridge.POWER_OFF), left):
            self.enabled(gripper="b")
            self.command(bridge.TARGET, (0.0, 1.1))
            happens()
            self.command(bridge.ENABLE)
            self.assertEqual((self.arm.calls[-1], self.arm.effort), (("move", [1.0, 2.0]), 0.0))
            self.client.close()
            self.client, self.sequence = self.dial(), 0

    def test_old_heartbeats_keep_nobody_alive(self):
        self.enabled()
        self.session.watchdog_s = 0.1
        for _ in range(4):
            time.sleep(0.04)
            self.command(bridge.HEARTBEAT, age_s=5)
        self.assertEqual(self.session.flags, bridge.HELD)

    def test_a_driver_that_stood_still_holds_before_it_reads(self):
        self.enabled()
        self.session.watchdog_s = 0.1
        payload = bridge.COMMAND.pack(time.monotonic_ns() + 110_000_000, 0, bridge.TARGET, 0, 0.5)
        self.client.send(bridge.HEADER.pack(b"RSBR", 1, 5, 48, 999) + payload + struct.pack("<2d", 5.0, 6.0))
        time.sleep(0.12)
        self.step()
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])])

    def test_a_client_that_hangs_up_is_held_at_once_and_the_next_one_let_in(self):
        self.enabled()
        payload = bridge.COMMAND.pack(time.monotonic_ns(), 0, bridge.HEARTBEAT, 0, 0.5) + struct.pack("<2d", 0, 0)
        self.client.send(bridge.HEADER.pack(b"RSBR", 1, 5, len(payload), 99) + payload)  # read before the end is seen
        self.client.close()
        self.client = self.dial()
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])])
        self.sequence = 0
        self.hello()
        self.assertEqual(self.answer()[0], bridge.WELCOME)

    def test_a_second_client_is_refused_and_the_first_goes_on(self):
        self.enabled()
        first, self.client = self.client, self.dial()
        kind, payload = self.answer()
        self.assertEqual(kind, bridge.REFUSAL)
        self.assertIn("another client", json.loads(payload)["reason"])
        self.client = first
        self.command(bridge.TARGET)
        self.assertEqual(len(self.arm.calls), 1)

    def test_wrong_greetings_are_refused_with_the_reason(self):
        for hello, words in ((lambda: self.hello(axes=("a", "c")), "this driver has"),
                             (lambda: self.hello(axes=("a",)), "this driver has"),
                             (lambda: self.hello(axes=5), "this driver has"),
                             (lambda: self.hello(protocol=2), "version 2"),
                             (lambda: self.frame(bridge.HELLO, b"{"), "cannot be read"),
                             (lambda: self.frame(bridge.HELLO, b"[]"), "cannot be read"),
                             (lambda: self.frame(bridge.HELLO, b"{}", version=3), "version 3"),
                             (lambda: self.frame(bridge.HELLO, b"{}", magic=b"HTTP"), "no frame"),
                             (lambda: self.command(bridge.TARGET), "kind 5")):
            hello()
            kind, payload = self.answer()
            self.assertEqual(kind, bridge.REFUSAL)
            self.assertIn(words, json.loads(payload)["reason"])
            self.client = self.dial()

    def test_a_command_of_a_wrong_length_ends_the_connection_and_holds(self):
        self.enabled()
        self.command(bridge.TARGET, (1.0,))
        self.assertIsNone(self.session.client)
        self.assertEqual(self.arm.calls, [("move", [1.0, 2.0])])

    def test_failed_reads_are_a_fault_after_five(self):
        self.enabled()
        faults = []
        for broken in (False, True, True, True, True, True):
            self.arm.broken = broken
            self.step(states=True)
            _, payload = self.answer()
            faults.append(bridge.STATE.unpack_from(payload)[5])
        self.assertEqual(faults, [0, 0, 0, 0, 0, bridge.FAULT_JOINT_BUS])

    def test_a_living_drivers_socket_is_not_taken(self):
        with self.assertRaises(SystemExit):
            bridge.listen(self.path)
        self.session.listener.close()
        bridge.listen(self.path).close()

    def test_what_is_no_dead_drivers_socket_stays(self):
        file, folder = os.path.join(self.folder.name, "calib.json"), os.path.join(self.folder.name, "runs")
        with open(file, "w") as written:
            written.write("{}")
        os.mkdir(folder)
        other = os.path.join(self.folder.name, "other")  # listens, but is no stream
        datagrams = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.addCleanup(datagrams.close)
        datagrams.bind(other)
        for path, words in ((file, "not a socket"), (folder, "not a socket"), (other, "is not known")):
            with self.assertRaises(SystemExit) as refused:
                bridge.listen(path)
            self.assertIn(path, str(refused.exception))
            self.assertIn(words, str(refused.exception))
            self.assertIn("take another path", str(refused.exception))
            self.assertTrue(os.path.lexists(path))
        with open(file) as read:
            self.assertEqual(read.read(), "{}")

    def test_a_driver_that_ends_tells_its_arm_again_closes_it_and_removes_its_own_socket(self):
        self.enabled()
        self.arm.deaf = 2
        self.session.end()
        self.assertEqual((self.arm.calls, self.arm.closed), ([("move", [1.0, 2.0])], True))
        self.assertFalse(os.path.exists(self.path))

    def test_a_socket_that_is_gone_or_anothers_keeps_no_arm_open(self):
        os.unlink(self.path)
        self.session.end()
        self.assertTrue(self.arm.closed)
        first = bridge.Session(Noted(), self.path)
        os.unlink(self.path)
        second = bridge.listen(self.path)
        self.addCleanup(second.close)
        first.end()
        self.assertTrue(first.arm.closed)
        self.assertTrue(os.path.exists(self.path), "a newer driver's")

    def test_a_client_that_cannot_be_told_goodbye_keeps_no_arm_open(self):
        self.enabled()
        self.session.drop = lambda why: 1 / 0
        with self.assertRaises(ZeroDivisionError):
            self.session.end()
        self.assertTrue(self.arm.closed)
        self.assertFalse(os.path.exists(self.path))


if __name__ == "__main__":
    unittest.main()
