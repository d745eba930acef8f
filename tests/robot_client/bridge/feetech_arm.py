#!/usr/bin/env python3
"""Six STS3215 servos on a serial bus: what LeRobot's own SO-101 class talks to, on a pseudo terminal.

    feetech_arm.py LINK CALIBRATION_JSON

LINK becomes a symbolic link to the terminal; the file is the calibration that the servos hold, in
LeRobot's form. Written from the vendor's description of protocol 0: FF FF ID LENGTH INSTRUCTION
PARAMETERS CHECKSUM, memory addresses as in LeRobot's control table. A servo with power goes to its
goal as a first-order lag of 60 ms, at most 180 degrees a second; one without falls by 5 degrees a
second to its lower end.
"""

import json
import os
import sys
import termios
import time
import tty

PING, READ, WRITE, SYNC_READ, SYNC_WRITE, EVERYBODY = 1, 2, 3, 0x82, 0x83, 0xFE
MODEL, LOWEST, HIGHEST, OFFSET, TORQUE, GOAL, PRESENT = 3, 9, 11, 31, 40, 42, 56
LAG_S, COUNTS = 0.06, 4095 / 360
NAMES = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"]


class Servo:
    def __init__(self, number):
        self.number, self.memory = number, bytearray(256)
        self.put(MODEL, 777)
        self.memory[0], self.memory[1], self.memory[5] = 3, 10, number
        self.put(LOWEST, 800)
        self.put(HIGHEST, 3300)
        self.at, self.moved = 2050.0 + 40 * number, time.monotonic()
        self.put(GOAL, int(self.at))
        self.put(PRESENT, int(self.at))

    def get(self, address):
        return int.from_bytes(self.memory[address : address + 2], "little")

    def put(self, address, value):
        self.memory[address : address + 2] = int(value).to_bytes(2, "little")

    def advance(self):
        now = time.monotonic()
        dt, self.moved = now - self.moved, now
        if self.memory[TORQUE]:
            share = min(1.0, dt / LAG_S)
            most = 180 * COUNTS * dt
            self.at += max(-most, min(most, share * (self.get(GOAL) - self.at)))
        else:
            self.at = max(self.get(LOWEST), self.at - 5 * COUNTS * dt)
        self.put(PRESENT, round(self.at))

    def answer(self, parameters=b""):
        body = bytes([self.number, len(parameters) + 2, 0]) + parameters
        return b"\xff\xff" + body + bytes([~sum(body) & 0xFF])


def obey(servos, number, instruction, parameters):
    """The bytes that come back on the bus."""
    here = list(servos.values()) if number == EVERYBODY else [servos[number]] if number in servos else []
    for servo in servos.values():
        servo.advance()
    if instruction == PING:
        return b"".join(servo.answer() for servo in here)
    if instruction == READ:
        address, count = parameters[0], parameters[1]
        return b"".join(servo.answer(bytes(servo.memory[address : address + count])) for servo in here)
    if instruction == WRITE:
        for servo in here:
            servo.memory[parameters[0] : parameters[0] + len(parameters) - 1] = parameters[1:]
        return b"".join(servo.answer() for servo in here if number != EVERYBODY)
    if instruction == SYNC_READ:
        address, count = parameters[0], parameters[1]
        asked = [servos[i] for i in parameters[2:] if i in servos]
        return b"".join(servo.answer(bytes(servo.memory[address : address + count])) for servo in asked)
    if instruction == SYNC_WRITE:
        address, count = parameters[0], parameters[1]
        for at in range(2, len(parameters), count + 1):
            servo = servos[parameters[at]]
            servo.memory[address : address + count] = parameters[at + 1 : at + 1 + count]
    return b""


def main():
    link, calibration = sys.argv[1], sys.argv[2]
    servos = {i: Servo(i) for i in range(1, 7)}
    with open(calibration, "w") as file:
        json.dump({name: {"id": i + 1, "drive_mode": 0, "homing_offset": 0, "range_min": 800,
                          "range_max": 3300} for i, name in enumerate(NAMES)}, file)
    ours, theirs = os.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    settings = termios.tcgetattr(theirs)
    settings[3] &= ~termios.ECHO
    termios.tcsetattr(theirs, termios.TCSANOW, settings)
    os.symlink(os.ttyname(theirs), link)
    came = b""
    while True:
        came += os.read(ours, 4096)
        while True:
            start = came.find(b"\xff\xff")
            if start < 0 or len(came) < start + 6 or len(came) < start + 4 + came[start + 3]:
                break
            end = start + 4 + came[start + 3]
            frame, came = came[start:end], came[end:]
            if frame[-1] != ~sum(frame[2:-1]) & 0xFF:
                continue
            os.write(ours, obey(servos, frame[2], frame[4], frame[5:-1]))


if __name__ == "__main__":
    main()
