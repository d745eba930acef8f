"""The driver's end of RoboStress's bridge: what robot_client --arm bridge:unix:SOCKET talks to.

A driver process owns one arm and gives it to one client. This file is the wire, the watchdog and
the loop; a driver is an `Arm` of its own and a call of `serve`. Standard library only.

Frames. 16 bytes in front, little endian: b"RSBR", version u8, kind u8, payload length u16, sequence
u64 (grows from frame to frame). Stamps are time.monotonic_ns(), which both ends read. Values are
floats of 8 bytes in the driver's own units, in the order of the client's hello.

    1 HELLO    client   JSON: protocol, robot, axes (names), gripper (one of them, or null), rate_hz
    2 WELCOME  driver   JSON: see Session.welcome
    3 REFUSAL  driver   JSON: reason; then it closes
    4 STATE    driver   stamp, sent, command u64, command_ns, flags u32, faults u32, then position,
                        velocity and effort of every axis
    5 COMMAND  client   stamp, state u64, mode u32, 0 u32, gripper effort, then a target per axis
    6 BYE      either   nothing

robot_client/bridge/README.md says what each end does with them.
"""

import json
import logging
import math
import os
import select
import signal
import socket
import stat
import struct
import time

LOG = logging.getLogger("robostress")
VERSION = 1
HEADER = struct.Struct("<4sBBHQ")
STATE = struct.Struct("<qqQqII")
COMMAND = struct.Struct("<qQIId")
MOST_PAYLOAD = 4096
HELLO, WELCOME, REFUSAL, STATE_KIND, COMMAND_KIND, BYE = range(1, 7)
HEARTBEAT, TARGET, ENABLE, POWER_OFF, STOP, ACKNOWLEDGE = range(6)
POWERED, TAKING, HELD, STOPPED = 1, 2, 4, 8
# Bits of a state's faults, as robot_client/robot_arm.h names them.
FAULT_EMERGENCY_STOP, FAULT_JOINT_LIMIT, FAULT_JOINT_BUS = 1 << 0, 1 << 3, 1 << 4
FAULT_COLLISION, FAULT_STALL, FAULT_OVER_CURRENT = 1 << 6, 1 << 7, 1 << 8
FAULT_OVER_TEMPERATURE, FAULT_UNDER_VOLTAGE, FAULT_DRIVER = 1 << 9, 1 << 10, 1 << 11
FAULT_OTHER = 1 << 13
OLDEST_COMMAND_NS = 100_000_000  # an older target is not obeyed
OLDEST_READING_NS = 100_000_000  # an older reading does not say where the arm stands
LAST_TRIES_S = 1.0  # a driver that ends tells the arm to hold for so long
FAILED_READS = 5  # in a row: a fault. Of fewer the client sees that no new sample came


class Broken(Exception):
    """Bytes or a greeting that end a connection; the text goes to the client."""


class Arm:
    """What a driver does. Positions are in its own units, one a name of `axes`.

    Everything is called from one thread. An exception is reported to the client as a fault of the
    driver, that of read when it comes five times in a row. What the arm was told on silence, and a
    stop, is told again until it raises no more; for all else the arm is left as it is.
    """

    driver = "a driver"  # program, for people
    robot = "an arm"  # which one: a driver that is started again must say the same
    axes = ()  # names
    # By name, where it is known: "radians", "degrees", "metres", or the two ends of a range, (0, 100).
    units = {}
    stop_is_more = False  # stop() does more than hold()
    holds = True  # the arm keeps its place when no target comes
    can_power_off = False
    measures_velocity = False
    measures_effort = False  # [Nm]
    simulated = False
    note = ""  # what a person should know, one line
    # Kept by look and the session, for hold.
    last_reading = None  # of numbers, as read gives it
    last_target = None  # since enable, while the arm has power
    grip = None  # (axis, target, effort) of the gripper, while the arm has power

    def open(self):
        """Connects to the arm, once its socket is this driver's. The arm does not move by it.

        What is raised ends the driver; the arm is left as it is, with its power.
        """

    def read(self):
        """(stamp [ns, monotonic], positions, velocities or None, efforts or None, faults)."""
        raise NotImplementedError

    def move(self, targets, gripper_effort):
        """New targets; does not wait until they are reached."""
        raise NotImplementedError

    def enable(self):
        """Gives the joints power; the arm holds where it stands. Power that is there may stay."""
        self.hold()

    def look(self):
        """What read gives, remembered for hold where all of it are numbers."""
        reading = self.read()
        if all(map(math.isfinite, reading[1])):
            self.last_reading = reading
        return reading

    def hold(self):
        """The target becomes where the arm stands; what the gripper holds it goes on holding.

        Where no number can be read now, the last reading counts while it is young, then the last
        target, to which the arm is on its way: an old reading would lead it back.
        """
        unread = None
        try:
            self.look()
        except Exception as error:  # whatever a vendor's driver raises
            unread = error
        oldest = time.monotonic_ns() - OLDEST_READING_NS
        if self.last_reading is not None and self.last_reading[0] >= oldest:
            targets = list(self.last_reading[1])
        elif self.last_target is not None:
            targets = list(self.last_target)
        else:
            raise RuntimeError("where the arm stands is not known")
        effort = 0.0
        if self.grip is not None:
            axis, opening, effort = self.grip
            targets[axis] = opening
        self.move(targets, effort)
        if unread is not None:
            LOG.warning("the arm holds without having been read: %r", unread)

    def stop(self):
        """The fastest stop that there is."""
        self.hold()

    def power_off(self):
        """Takes the power off; the arm may fall."""
        raise NotImplementedError

    def powered(self):
        return True

    def close(self):
        """The driver ends."""


class Session:
    """One arm, its socket and at most one client."""

    def __init__(self, arm, path, state_hz=100.0, watchdog_s=0.25, on_silence="hold"):
        self.arm, self.path, self.watchdog_s, self.on_silence = arm, path, watchdog_s, on_silence
        self.state_hz = state_hz
        self.period = 1.0 / state_hz
        self.client, self.buffer, self.greeted = None, b"", False
        self.enabled = False  # by this client, once
        self.flags, self.order, self.gripper = 0, [], None
        self.owed = None  # (what, flag): the arm was told and has not obeyed yet
        self.heard = self.taken = self.taken_ns = self.seen = self.sequence = 0
        self.last = (0, [0.0] * len(arm.axes), None, None, 0)
        self.failed = 0  # faults of this driver, until a person has seen them
        self.missed = 0  # reads in a row that raised
        self.ended = False
        self.complained = {}
        self.listener = listen(path)
        self.place = place(path)

    # --- what the client is told -------------------------------------------------------------------

    def welcome(self):
        arm = self.arm
        return {
            "protocol": VERSION,
            "driver": arm.driver,
            "robot": arm.robot,
            "axes": [arm.axes[i] for i in self.order],
            "units": {name: unit for name, unit in arm.units.items() if name in arm.axes},
            "clock": "monotonic",
            "stop": arm.stop_is_more,
            "hold": arm.holds,
            "torque_off": arm.can_power_off,
            "measures_velocity": arm.measures_velocity,
            "measures_effort": arm.measures_effort,
            "simulated": arm.simulated,
            "on_silence": self.on_silence,
            "watchdog_s": self.watchdog_s,
            "state_hz": self.state_hz,
            "note": arm.note,
        }

    def send(self, kind, payload):
        self.sequence += 1
        frame = HEADER.pack(b"RSBR", VERSION, kind, len(payload), self.sequence) + payload
        try:
            if self.client.send(frame) != len(frame):
                raise Broken("a part of a frame was sent")
        except BlockingIOError:
            self.complain("the client does not read; a frame was left out")
        except OSError as error:
            raise Broken(f"the client is gone: {error.strerror}") from error

    def send_state(self):
        stamp, position, velocity, effort, faults = self.last
        try:
            self.last = stamp, position, velocity, effort, faults = self.arm.look()
            self.missed = 0
        except Exception as error:  # whatever a vendor's driver raises
            self.complain(f"the arm cannot be read: {error!r}")
            self.missed += 1
            faults |= FAULT_JOINT_BUS if self.missed >= FAILED_READS else 0
        if not self.greeted:
            return
        faults |= self.failed
        powered = self.flags
        if self.arm.powered():
            powered |= POWERED
        else:
            # Limp fingers: whoever gives them power again may have his own between them.
            self.arm.grip = self.arm.last_target = None
        nothing = [0.0] * len(position)
        values = [
            float(row[i])
            for row in (position, velocity or nothing, effort or nothing)
            for i in self.order
        ]
        head = STATE.pack(
            stamp, time.monotonic_ns(), self.taken, self.taken_ns, powered, faults
        )
        self.send(STATE_KIND, head + struct.pack(f"<{len(values)}d", *values))

    # --- what the client says ----------------------------------------------------------------------

    def frames(self):
        """(kind, sequence, payload) of all that has come whole."""
        try:
            data = self.client.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError as error:
            raise Broken(f"the client is gone: {error.strerror}") from error
        if not data:
            raise Broken("the client has hung up")
        self.buffer += data
        while len(self.buffer) >= HEADER.size:
            magic, version, kind, size, sequence = HEADER.unpack_from(self.buffer)
            if magic != b"RSBR" or size > MOST_PAYLOAD:
                raise Broken("bytes that are no frame")
            if version != VERSION:
                raise Broken(f"version {version}, this driver speaks {VERSION}")
            if len(self.buffer) < HEADER.size + size:
                return
            payload = self.buffer[HEADER.size : HEADER.size + size]
            self.buffer = self.buffer[HEADER.size + size :]
            yield kind, sequence, payload

    def greet(self, payload):
        try:
            hello = json.loads(payload)
            axes = hello["axes"]
        except (ValueError, KeyError, TypeError) as error:
            raise Broken("a hello that cannot be read") from error
        if hello.get("protocol") != VERSION:
            raise Broken(f"version {hello.get('protocol')}, this driver speaks {VERSION}")
        if not isinstance(axes, list) or sorted(map(str, axes)) != sorted(self.arm.axes):
            raise Broken(f"axes {axes}; this driver has {list(self.arm.axes)}")
        self.order = [self.arm.axes.index(name) for name in axes]
        gripper = hello.get("gripper")
        self.gripper = self.arm.axes.index(gripper) if gripper in axes else None
        self.greeted, self.enabled = True, False
        self.send(WELCOME, json.dumps(self.welcome()).encode())
        LOG.info("a client drives %s", ", ".join(axes))

    def take_all(self):
        """Obeys what has come; of several targets the newest."""
        target = None
        for kind, sequence, payload in self.frames():
            if kind == HELLO and not self.greeted:
                self.greet(payload)
            elif kind == BYE:
                raise Broken("the client says goodbye")
            elif kind != COMMAND_KIND or not self.greeted:
                raise Broken(f"a frame of kind {kind}")
            else:
                target = self.take(sequence, payload, target)
        if target is not None:
            self.arm.move(*target)
            self.arm.last_target = target[0]
            if self.gripper is not None:
                self.arm.grip = self.gripper, target[0][self.gripper], target[1]

    def take(self, sequence, payload, target):
        n = len(self.order)
        if len(payload) != COMMAND.size + 8 * n:
            raise Broken(f"a command of {len(payload)} bytes, {COMMAND.size + 8 * n} are right")
        stamp, _, mode, _, effort = COMMAND.unpack_from(payload)
        values = struct.unpack_from(f"<{n}d", payload, COMMAND.size)
        now = time.monotonic_ns()
        if sequence <= self.seen:
            self.complain("a command came again, or late: left out")
            return target
        self.seen = sequence
        if mode == STOP or mode == POWER_OFF:  # however old: they are the safe side
            target = None
            if mode == POWER_OFF:
                self.arm.power_off()
                self.flags, self.owed, self.arm.grip = self.flags & ~TAKING, None, None
            elif not self.flags & STOPPED:  # once: where the arm stands would sink with it
                self.flags &= ~TAKING
                self.obey("stop", STOPPED)
        elif abs(now - stamp) > OLDEST_COMMAND_NS:
            self.complain(f"a command is {(now - stamp) / 1e6:.0f} ms old: left out")
            return target
        elif mode == ENABLE:
            self.arm.last_target = None  # it holds where it stands: it may have been moved by hand
            if not self.enabled:
                self.arm.grip = None  # nobody has watched its power since the last client
            self.arm.enable()
            self.enabled, self.flags, self.owed, target = True, TAKING, None, None
        elif mode == ACKNOWLEDGE:
            self.failed = 0
        elif mode == TARGET and self.flags & TAKING:
            if not all(map(math.isfinite, values)) or not math.isfinite(effort):
                self.complain("a target is no number: left out")
                return target
            places = [0.0] * n
            for place, value in zip(self.order, values):
                places[place] = value
            target = (places, effort)
        self.heard, self.taken, self.taken_ns = time.monotonic(), sequence, now
        return target

    # --- the loop ----------------------------------------------------------------------------------

    def complain(self, text):
        """Once a second for each beginning of a text."""
        key, now = text[:24], time.monotonic()
        if now - self.complained.get(key, -1) >= 1:
            self.complained[key] = now
            LOG.warning("%s", text)

    def silent(self, why):
        """The client is silent or gone: what was agreed happens, once."""
        if not self.flags & TAKING:
            return
        self.flags &= ~TAKING
        LOG.warning("%s: %s", why, self.on_silence)
        self.obey(self.on_silence, HELD)

    def obey(self, what, flag):
        """Tells the arm, with every state anew until it obeys; only then the client reads `flag`."""
        self.owed = what, flag
        try:
            {"hold": self.arm.hold, "stop": self.arm.stop, "torque_off": self.arm.power_off,
             "nothing": lambda: None}[what]()
        except Exception as error:  # whatever a vendor's driver raises
            self.complain(f"the arm did not obey, it is told to {what} again: {error!r}")
            self.failed |= FAULT_DRIVER
            return
        self.owed = None
        self.flags |= flag
        if what == "torque_off":
            self.arm.grip = None

    def drop(self, why):
        LOG.info("%s", why)
        self.silent(why)
        self.client.close()
        self.client, self.buffer, self.greeted, self.seen = None, b"", False, 0

    def gone(self):
        """The client has hung up, and what it said before has been read."""
        try:
            return self.client.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def accept(self):
        connection, _ = self.listener.accept()
        connection.setblocking(False)
        if self.client is not None and self.gone():
            self.drop("the client has hung up")
        if self.client is None:
            self.client = connection
            return
        reason = json.dumps({"reason": "another client drives this arm; end it first"}).encode()
        try:
            connection.send(HEADER.pack(b"RSBR", VERSION, REFUSAL, len(reason), 1) + reason)
        except OSError:
            pass
        connection.close()

    def step(self, due):
        """Waits until `due` at most [s, monotonic] and does what there is to do."""
        waits = [self.listener] + ([self.client] if self.client else [])
        ready = select.select(waits, [], [], max(0.0, due - time.monotonic()))[0]
        # Before anything is read: a driver that stood still has heard nothing either.
        if self.flags & TAKING and time.monotonic() - self.heard > self.watchdog_s:
            self.silent(f"silent for {self.watchdog_s} s")
        elif self.owed and time.monotonic() >= due:
            self.obey(*self.owed)
        if self.client is not None:
            try:
                if self.client in ready:
                    self.take_all()
                if time.monotonic() >= due:
                    self.send_state()
            except Broken as broken:
                if not self.greeted:
                    self.refuse(str(broken))
                self.drop(str(broken))
            except Exception as error:  # whatever a vendor's driver raises
                self.complain(f"the arm did not obey: {error!r}")
                self.failed |= FAULT_DRIVER
        if self.listener in ready:  # last: who was there before may just have gone
            self.accept()

    def refuse(self, reason):
        try:
            self.send(REFUSAL, json.dumps({"reason": reason}).encode())
        except Broken:
            pass

    def run(self):
        """Until SIGTERM or SIGINT; then the arm holds, and the driver ends."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: setattr(self, "ended", True))
        due = time.monotonic()
        try:
            while not self.ended:
                self.step(due)
                now = time.monotonic()
                if now >= due:
                    due = max(due + self.period, now)  # what was missed is not made up for
        finally:
            self.end()

    def leave(self):
        """The socket is nobody's any more."""
        try:
            self.listener.close()
            if place(self.path) == self.place:  # not a newer driver's
                os.unlink(self.path)
        except OSError as error:
            LOG.warning("%s is left: %s", self.path, error.strerror)

    def end(self):
        """The arm holds and is closed, whatever else fails."""
        try:
            if self.client is not None:
                try:
                    self.send(BYE, b"")
                except Broken:
                    pass
                self.drop("the driver ends")
            until = time.monotonic() + LAST_TRIES_S
            while self.owed and time.monotonic() < until:
                time.sleep(self.period)
                self.obey(*self.owed)
        finally:
            try:
                self.leave()
            finally:
                self.arm.close()


def place(path):
    """What tells the file at `path` from a later one, whose inode may be the same number; or None."""
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns


def make_room(path):
    """A dead driver's socket at `path` is removed, and nothing else ever is."""
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise SystemExit(f"--socket {path}: that is a file, not a socket, and it stays; take another path")
    probe = socket.socket(socket.AF_UNIX)
    probe.settimeout(1)
    try:
        probe.connect(path)
    except ConnectionRefusedError:
        os.unlink(path)
    except FileNotFoundError:
        pass  # its driver has just ended
    except OSError as error:
        raise SystemExit(f"--socket {path}: whether a driver listens there is not known ({error}), so it stays; "
                         "remove it by hand, or take another path") from error
    else:
        raise SystemExit(f"{path}: a driver listens there already; end it, or take another --socket")
    finally:
        probe.close()


def listen(path):
    """A socket at `path` that only this user can reach. A dead driver's is taken over."""
    make_room(path)
    listener = socket.socket(socket.AF_UNIX)
    before = os.umask(0o177)
    try:
        listener.bind(path)
    finally:
        os.umask(before)
    listener.listen(4)
    listener.setblocking(False)
    return listener


def add_options(parser):
    """The options that every driver has."""
    parser.add_argument("--socket", required=True, help="path of the unix socket to listen on")
    parser.add_argument("--state-hz", type=float, default=100.0, help="states a second, 20 to 1000")
    parser.add_argument("--watchdog-s", type=float, default=0.25,
                        help="silence of the client after which the arm is held [s], 0.02 to 2")
    parser.add_argument("--on-silence", default="hold", choices=["hold", "stop", "torque_off", "nothing"])


def serve(arm, options):
    """Gives `arm` to one client after the other until the process is told to end."""
    if not 20 <= options.state_hz <= 1000 or not 0.02 <= options.watchdog_s <= 2:
        raise SystemExit("--state-hz must be 20 to 1000, --watchdog-s 0.02 to 2")
    if options.on_silence == "torque_off" and not arm.can_power_off:
        raise SystemExit("--on-silence torque_off: this arm's power cannot be taken off; use hold")
    session = Session(arm, options.socket, options.state_hz, options.watchdog_s, options.on_silence)
    try:  # now that nobody else has this arm
        arm.open()
    except BaseException:
        session.leave()
        raise
    print(f"{arm.driver}: {arm.robot} at {options.socket}", flush=True)
    session.run()
