#!/usr/bin/env python3
"""An arm of position servos behind the bridge, in real time, that fails when it is told to.

    emulated_driver.py --socket PATH [--fault KIND[:AMOUNT][@SECONDS]] ... [driver's options]

SECONDS count from the first enable. The servos are second order (natural frequency 25 rad/s,
critically damped, 2 rad/s at most). The five of --arm five know degrees, its gripper 0 to 100; the
seven of --arm seven, a Franka's in name and place, know radians, a finger of its hand metres. Kinds:

    die        the process is killed               hang       it stands still for ever, its socket open
    stall:S    it stands still for S seconds       silent     it sends no states
    late:S     states are sent S seconds late      restamp    one old measurement with new stamps
    replay     it sends one old frame for ever     raises     its read raises
    jump:N     every joint reads N more            nan        a position is no number
    count      a value too few in a state          garbage    bytes that are no frame
    version    frames of version 2                 flood      20 states where one is due
    unpowered  the joints say they have no power   collision  a fault bit
    blocked    the joints cannot move              deafstop   it says that it stops, and goes on
    nostop     it does not even say so
"""

import argparse
import logging
import math
import os
import signal
import struct
import sys
import time

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../deploy"))

import robostress_bridge as bridge

# By --arm: what it is, its joints, its gripper, where it stands, 2 rad/s in its own units.
ARMS = {
    "five": ("five servos", ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"], "gripper",
             [0.0, -30.0, 40.0, 10.0, 0.0, 50.0], math.degrees(2.0)),
    "seven": ("seven joints", [f"panda_joint{i}" for i in range(1, 8)], "panda_finger_joint1",
              [0.1, -0.6, 0.0, -2.2, 0.0, 1.6, 0.7, 0.02], 2.0),
}
STEP_S = 0.001
STIFFNESS = 25.0


class ServoArm(bridge.Arm):
    driver, can_power_off, simulated = "emulated_driver", True, True

    def __init__(self, kind, faults):
        self.robot, joints, gripper, position, self.most_speed = ARMS[kind]
        self.axes = [*joints, gripper]
        self.faults, self.enabled_at = faults, None
        self.position = list(position)
        self.speed = [0.0] * len(self.axes)
        self.target = list(self.position)
        self.on = True
        self.moved = time.monotonic()

    def fault(self, kind):
        """The amount of a fault that is there now (1 without one), or None."""
        if self.enabled_at is None:
            since = -1.0
        else:
            since = time.monotonic() - self.enabled_at
        for name, amount, at in self.faults:
            if name == kind and (since >= at or at == 0):
                return amount
        return None

    def advance(self):
        now = time.monotonic()
        if now - self.moved > 5:
            self.moved = now - 5
        while self.moved < now:
            self.moved += STEP_S
            if self.fault("blocked") is not None:
                self.speed = [0.0] * len(self.axes)
                continue
            for i in range(len(self.axes)):
                gap = self.target[i] - self.position[i]
                pull = STIFFNESS**2 * gap - 2 * STIFFNESS * self.speed[i] if self.on else 0.0
                self.speed[i] = max(-self.most_speed, min(self.most_speed, self.speed[i] + pull * STEP_S))
                self.position[i] += self.speed[i] * STEP_S

    def read(self):
        if self.fault("raises") is not None:
            raise RuntimeError("the bus does not answer")
        self.advance()
        shift = self.fault("jump") or 0.0
        position = [q + shift for q in self.position]
        if self.fault("nan") is not None:
            position[2] = math.nan
        return time.monotonic_ns(), position, None, None, (
            bridge.FAULT_COLLISION if self.fault("collision") is not None else 0)

    def move(self, targets, gripper_effort):
        self.advance()
        self.target = list(targets)

    def enable(self):
        self.hold()
        self.on = True
        if self.enabled_at is None:
            self.enabled_at = time.monotonic()

    def hold(self):
        self.advance()
        self.target = list(self.position)
        if self.grip is not None:
            self.target[self.grip[0]] = self.grip[1]

    def stop(self):
        if self.fault("deafstop") is not None:
            self.target = [q + 900 for q in self.target]  # on and on
        elif self.fault("nostop") is None:
            self.hold()

    def power_off(self):
        self.on = False

    def powered(self):
        return self.on and self.fault("unpowered") is None


class FaultySession(bridge.Session):
    """The wire, with faults."""

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.waiting, self.old, self.stalled = [], None, False

    def take(self, sequence, payload, target):
        target = super().take(sequence, payload, target)
        if self.arm.fault("nostop") is not None:
            self.flags &= ~bridge.STOPPED
        return target

    def send(self, kind, payload):
        fault = self.arm.fault
        if kind != bridge.STATE_KIND:
            return super().send(kind, payload)
        now = time.monotonic()
        if fault("die") is not None:
            os.kill(os.getpid(), signal.SIGKILL)
        if fault("hang") is not None:
            time.sleep(3600)
        if fault("stall") is not None and not self.stalled:
            self.stalled = True
            time.sleep(fault("stall"))
        if fault("silent") is not None:
            return None
        if fault("garbage") is not None:
            self.client.send(b"what is this" * 3)
        if fault("version") is not None:
            self.client.send(bridge.HEADER.pack(b"RSBR", 2, kind, len(payload), self.sequence + 1) + payload)
            return None
        if fault("count") is not None:
            payload = payload[:-8]
        if fault("replay") is not None:
            self.old = self.old or bridge.HEADER.pack(b"RSBR", 1, kind, len(payload), self.sequence) + payload
            self.client.send(self.old)
            return None
        if fault("restamp") is not None:
            self.old = self.old or payload
            payload = struct.pack("<q", time.monotonic_ns()) + self.old[8:]
        if fault("late") is not None:
            self.waiting.append((now, payload))
            while self.waiting and now - self.waiting[0][0] >= fault("late"):
                super().send(kind, self.waiting.pop(0)[1])
            return None
        for _ in range(20 if fault("flood") is not None else 1):
            super().send(kind, payload)
        return None


def parse_fault(text):
    head, _, at = text.partition("@")
    kind, _, amount = head.partition(":")
    return kind, float(amount or 1), float(at or 0)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    bridge.add_options(parser)
    parser.add_argument("--arm", choices=ARMS, default="five")
    parser.add_argument("--fault", action="append", default=[], type=parse_fault)
    parser.add_argument("--cannot", action="append", default=[], help="a field of Arm that becomes false")
    parser.add_argument("--log", help="a file that gets a line per 10 ms: t, target and position of joint 2")
    options = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    arm = ServoArm(options.arm, options.fault)
    arm.stop_is_more = True
    for name in options.cannot:
        assert hasattr(arm, name), name
        setattr(arm, name, False)
    session = FaultySession(arm, options.socket, options.state_hz, options.watchdog_s, options.on_silence)
    if options.log:
        log = open(options.log, "w", buffering=1)
        step = session.step

        def logged(due):
            step(due)
            arm.advance()
            log.write(f"{time.monotonic():.4f} {arm.target[1]:.4f} {arm.position[1]:.4f} {session.flags}\n")

        session.step = logged
    print(f"{arm.driver}: {arm.robot} at {options.socket}", flush=True)
    session.run()


if __name__ == "__main__":
    main()
