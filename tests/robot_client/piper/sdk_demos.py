"""Every V2 demo of the vendor's piper_sdk, unmodified, against piper_emulator: what moved and what was
answered, as a table demo x effect. Exits with the number of rows that are wrong.

  sdk_conformance.sh EMULATOR sdk_demos.py [DEMO ...]          makes the network namespace
  sdk_conformance.sh EMULATOR sdk_demos.py --write README.md   replaces the table between its marks

A demo names "socketcan"; the launcher gives it python-can's udp_multicast instead and skips the SDK's look
at /sys/class/net. Effects are read from the bus by a listener of its own, not from what the SDK prints,
except where printing is all that a demo does."""
import math
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

GROUP, PORT = "239.74.163.2", 43113
MARK = "<!-- sdk-demos -->"


def launch(path):
    """In a process of its own: runs one demo."""
    import runpy
    import can
    from piper_sdk.hardware_port import C_STD_CAN
    real = can.interface.Bus
    can.interface.Bus = lambda *_, **__: real(channel=GROUP, bustype="udp_multicast", port=PORT)
    C_STD_CAN.JudgeCanInfo = lambda self: self.CAN_STATUS.JUDGE_PASS
    sys.argv = [path]
    runpy.run_path(path, run_name="__main__")


def int32(data, at):
    return int.from_bytes(data[at:at + 4], "big", signed=True)


def int16(data, at):
    return int.from_bytes(data[at:at + 2], "big", signed=True)


class Bus:
    """Hears everything; can speak."""

    def __init__(self):
        import can
        self.can = can
        self.bus = can.Bus(channel=GROUP, interface="udp_multicast", port=PORT)
        self.frames, self.running = [], True
        self.thread = threading.Thread(target=self.listen, daemon=True)
        self.thread.start()

    def listen(self):
        while self.running:
            message = self.bus.recv(0.1)
            if message is not None:
                self.frames.append((time.monotonic(), message.arbitration_id, bytes(message.data)))

    def say(self, identifier, *data):
        self.bus.send(self.can.Message(arbitration_id=identifier, is_extended_id=False,
                                       data=bytes(data) + bytes(8 - len(data))))

    def close(self):
        self.running = False
        self.thread.join()
        self.bus.shutdown()


class Seen:
    """What was on the bus from `since` on, and what the demo printed."""

    def __init__(self, frames, since, out, code):
        self.frames = [frame for frame in frames if frame[0] >= since]
        self.out, self.code = out, code

    def data(self, identifier, since=0.0):
        return [d for t, i, d in self.frames if i == identifier and t >= since]

    def at(self, identifier):
        return [(t, d) for t, i, d in self.frames if i == identifier]

    def joint(self, number):  # degrees over time
        pair, second = divmod(number - 1, 2)
        return [int32(d, 4 * second) / 1e3 for d in self.data(0x2A5 + pair)]

    def joints(self):  # the last ones
        return [self.joint(j)[-1] for j in range(1, 7)]

    def tool(self):  # [mm] over time, with time: x y from 0x2A2, z of the 0x2A3 that follows
        path, xy = [], None
        for t, i, d in self.frames:
            if i == 0x2A2:
                xy = (int32(d, 0) / 1e3, int32(d, 4) / 1e3)
            elif i == 0x2A3 and xy:
                path.append((t, (*xy, int32(d, 0) / 1e3)))
        return path

    def opening(self):
        return [int32(d, 0) / 1e3 for d in self.data(0x2A8)]

    def status(self):
        return [d[1] for d in self.data(0x2A1)]

    def enabled(self):  # the last bits of the six drivers
        return [bool(self.data(i)[-1][5] & 0x40) for i in range(0x261, 0x267)]

    def answers(self, identifier):
        return self.data(identifier)

    def acknowledged(self):  # low bytes of writes, and whether a zero was set
        return [(d[0], d[1]) for d in self.data(0x476)]

    def numbers(self, pattern):
        return [float(x) for x in re.findall(pattern, self.out)]


def line_error(points, start, end):
    """Largest distance of points from the straight line [mm]."""
    way = [b - a for a, b in zip(start, end)]
    norm = math.hypot(*way)
    worst = 0
    for p in points:
        d = [b - a for a, b in zip(start, p)]
        along = sum(a * b for a, b in zip(d, way)) / norm
        worst = max(worst, math.hypot(*[a - along * b / norm for a, b in zip(d, way)]))
    return worst


def circle_error(points, a, b, c):
    """Largest distance of points from the circle through a, b, c [mm]."""
    sub = lambda u, v: [x - y for x, y in zip(u, v)]
    cross = lambda u, v: [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    dot = lambda u, v: sum(x * y for x, y in zip(u, v))
    u, v = sub(b, a), sub(c, a)
    n = cross(u, v)
    nn = dot(n, n)
    to = [(dot(v, v) * x - dot(u, u) * y) / (2 * nn) for x, y in zip(cross(n, u), cross(n, v))]
    centre, radius = [x + y for x, y in zip(a, to)], math.hypot(*to)
    worst = 0
    for p in points:
        d = sub(p, centre)
        height = dot(d, n) / math.sqrt(nn)
        worst = max(worst, math.hypot(height, math.sqrt(max(dot(d, d) - height ** 2, 0)) - radius))
    return worst


# What a demo finds when it starts.
def power(bus):
    for _ in range(2):
        bus.say(0x471, 7, 2)
        time.sleep(0.1)


def lift(bus):
    """With power, in a pose from which an arm falls."""
    power(bus)
    for _ in range(40):
        bus.say(0x151, 1, 1, 100)
        for i, (first, second) in enumerate([(0, 60000), (-60000, 0), (0, 0)]):
            bus.say(0x155 + i, *first.to_bytes(4, "big", signed=True), *second.to_bytes(4, "big", signed=True))
        time.sleep(0.05)


def lead(bus):
    bus.say(0x470, 0xFA)
    time.sleep(0.2)


def open_gripper(bus):
    power(bus)
    bus.say(0x159, *(30000).to_bytes(4, "big"), 0x03, 0xE8, 1)
    time.sleep(1)


def slow_joint_1(bus):
    bus.say(0x474, 1, 0x7F, 0xFF, 0x7F, 0xFF, 0, 150)
    time.sleep(0.2)


def ask_limits(bus):
    for motor in range(1, 7):
        bus.say(0x472, motor, 1)
        bus.say(0x472, motor, 2)
        time.sleep(0.02)
    time.sleep(0.2)


# Judges: what happened, and whether it is right.
def near(values, wanted, tolerance):
    return all(abs(a - b) <= tolerance for a, b in zip(values, wanted))


def joint_moves(s):
    wanted = [11.459, 11.459, -11.459, 17.189, -11.459, 28.648]
    far = [max(s.joint(j), key=abs) for j in range(1, 7)]
    opening = max(s.opening())
    return (f"joints to {', '.join(f'{q:.1f}' for q in far)} degrees, gripper to {opening:.0f} mm (80 asked, range 70)",
            near(far, wanted, 0.5) and abs(opening - 70) <= 1 and 0 in s.status())


def pose_moves(s):
    targets = [(t, int32(d, 0) / 1e3) for t, d in s.at(0x153)]
    turns = [t for (t, z), (_, before) in zip(targets[1:], targets) if z != before]
    ends = [[p for t, p in s.tool() if t < turn][-1] for turn in turns]
    far = max(math.dist(p, (57, 0, z)) for p, z in zip(ends, [215, 260, 215]))
    bent = line_error([p for t, p in s.tool() if t > turns[0]], (57, 0, 215), (57, 0, 260))
    return (f"tool to z = {', '.join(f'{p[2]:.1f}' for p in ends)} mm, within {far:.2f} mm of the poses; between them "
            f"{bent:.1f} mm off the line, which mode P does not promise", len(ends) >= 2 and far <= 1)


def line_moves(s):
    z = [p[2] for _, p in s.tool()]
    begun = s.at(0x152)[0][0]
    path = [p for t, p in s.tool() if t > begun + 2.2]
    error = line_error(path, (57, 0, 215), (57, 0, 260))
    return (f"tool between z = {min(p[2] for p in path):.1f} and {max(z):.1f} mm, {error:.2f} mm off the line at most",
            abs(max(z) - 260) <= 1 and error <= 1 and set(s.status()) == {0})


def square(s):
    times = [t for t, d in s.at(0x154)]
    corners = [(150, -50, 150), (150, 50, 150), (250, 50, 150), (250, -50, 150), (150, -50, 150)]
    errors, ends = [], []
    for i in range(1, len(times)):
        until = times[i + 1] if i + 1 < len(times) else times[i] + 2.5
        leg = [p for t, p in s.tool() if times[i] < t < until]
        errors.append(line_error(leg, corners[i - 1], corners[i]))
        ends.append(math.dist(leg[-1], corners[i]))
    return (f"four lines of 100 mm, {max(errors):.2f} mm off them and {max(ends):.2f} mm off their ends at most",
            len(errors) == 4 and max(errors) <= 1 and max(ends) <= 1 and set(s.status()) == {0})


def arc(s):
    points = [(135.481, 9.349, 161.129), (222.158, 128.758, 142.126), (359.079, 3.221, 153.470)]
    if 2 in s.status():
        return "status 2, no solution", False
    path = [p for _, p in s.tool()]
    first = next((i for i, p in enumerate(path) if math.dist(p, points[0]) < 1), None)
    if first is None:
        return f"never at the first point; last at {[round(x) for x in path[-1]]}", False
    error = circle_error(path[first:], *points)
    middle = min(math.dist(p, points[1]) for p in path[first:])
    end = math.dist(path[-1], points[2])
    return (f"from the first point on the circle to {error:.2f} mm, past the second at {middle:.2f} mm, ends "
            f"{end:.2f} mm from the third", error <= 2 and middle <= 2 and end <= 1)


def torque_mode(s):
    q6, others = s.joint(6), [s.joint(j) for j in range(1, 6)]
    still = max(max(q) - min(q) for q in others)
    return (f"J6 from {min(q6):.1f} to {max(q6):.1f} degrees (28.6 asked), the others still to {still:.2f}",
            abs(min(q6) + 28.65) <= 2 and abs(max(q6) - 28.65) <= 2 and still <= 1)


def speed_write(s):
    last = {d[0]: int.from_bytes(d[5:7], "big") for d in s.answers(0x473)}
    return (f"six 0x476, 0x473 answers speed {sorted(set(last.values()))}: 30 rad/s in the arm's unit of 0.01 rad/s, ten "
            "times what the SDK means; our client refuses such an arm",
            s.acknowledged().count((0x74, 0)) == 6 and set(last.values()) == {3000} and len(last) == 6)


def gripper_parameters(s):
    answers = {tuple(d[:3]) for d in s.answers(0x47E)}
    return f"0x47E answers {sorted(answers)}, printed", answers == {(100, 70, 1)} and "max_range_config: 70" in s.out


def gripper_write(s):
    text, right = gripper_parameters(s)
    return "0x476 for 0x7D; " + text, right and (0x7D, 0) in s.acknowledged()


def installation(s):
    sent = s.data(0x151)
    return ("0x151 with installation 1 (upright); taken, the arm reports no installation",
            bool(sent) and sent[-1][5] == 1 and s.data(0x2A1)[-1][0] == 1)


def disable(s):
    z = [p[2] for _, p in s.tool()]
    return (f"six enable bits fall, the arm falls {max(z) - min(z):.0f} mm",
            not any(s.enabled()) and max(z) - min(z) > 50 and "失能成功" in s.out and s.code == 0)


def enable(s):
    return ("six enable bits, 0x476 for 0x71, prints success",
            all(s.enabled()) and (0x71, 0) in s.acknowledged() and "使能成功" in s.out and s.code == 0)


def zero_pose(s):
    return (f"joints within {max(abs(q) for q in s.joints()):.2f} degrees of zero, from 10 to 40",
            near(s.joints(), [0] * 6, 0.3) and abs(s.joint(2)[0]) > 10)


def gripper_moves(s):
    return (f"gripper to {max(s.opening()):.1f} and back to {s.opening()[-1]:.1f} mm or on its way",
            abs(max(s.opening()) - 50) <= 1)


def reset(s):
    return ("power off, status 1 ends", not any(s.enabled()) and s.status()[0] == 1 and s.status()[-1] == 0)


def stop(s):
    z = [p[2] for _, p in s.tool()]
    half = s.tool()[min(100, len(z) - 1)][1][2]
    return (f"status 1, enabled, the arm sinks {z[0] - z[-1]:.0f} mm, {z[0] - half:.0f} of them in the first 0.5 s",
            s.status()[-1] == 1 and all(s.enabled()) and 20 < z[0] - z[-1] and z[0] - half < 150)


def rates(s):
    totals = s.numbers(r"all_fps: ([\d.]+)")
    each = [s.numbers(rf"{name}: ([\d.]+)")[-1] for name in
            ("status", "end_pose", "joint_states", "gripper_msg", "high_spd", "low_spd")]
    return (f"prints {totals[-1]:.0f} frames per second, {', '.join(f'{x:.0f}' for x in each)} per kind",
            near(each, [200] * 5 + [40], 20) and abs(totals[-1] - 3040) <= 304)


def accelerations(s):
    last = {d[0]: int.from_bytes(d[1:3], "big") for d in s.answers(0x47C)}
    return (f"six 0x47C, {sorted(set(last.values()))} x 0.01 rad/s^2, printed",
            last == {j: 500 for j in range(1, 7)} and "500" in s.out)


def acceleration_write(s):
    text, right = accelerations(s)
    return "six 0x476 for 0x75; " + text, right and s.acknowledged().count((0x75, 0)) == 6


def speeds(s):
    last = {d[0]: (int16(d, 1), int16(d, 3), int16(d, 5)) for d in s.answers(0x473)}
    return (f"six 0x473; J1 {last.get(1)} x 0.1 degrees, 0.01 rad/s; printed",
            len(last) == 6 and last[1] == (1500, -1500, 300) and "1500" in s.out)


def crash(s):
    levels = {bytes(d[:6]) for d in s.answers(0x47B)}
    return (f"0x476 for 0x7A, {len(s.answers(0x47B))} answers 0x47B to queries with 0x03 in byte 4: levels 0",
            levels == {bytes(6)} and len(s.answers(0x47B)) > 20 and (0x7A, 0) in s.acknowledged())


def prints_pose(s):
    z = s.tool()[-1][1][2]
    said = s.numbers(r"\bZ_axis : (-?\d+)")[-1] / 1e3
    return f"prints z = {said:.3f} mm, the bus has {z:.3f}", abs(said - z) <= 0.5


def firmware(s):
    return "prints S-V1.8-9", "S-V1.8-9" in s.out and s.code == 0


def forward_kinematics(s):
    said = re.findall(r"feedback:\[(.*?)\]", s.out)[-1]
    p = [float(x) for x in said.split(",")[:3]]
    return (f"the SDK's own pose is {math.dist(p, s.tool()[-1][1]):.3f} mm from the arm's",
            math.dist(p, s.tool()[-1][1]) <= 0.1)


def prints(pattern, what):
    return lambda s: (what, re.search(pattern, s.out) is not None)


def leaders_targets(s):
    said = s.numbers(r"Joint[_ ]1\s*:\s*(-?[\d.]+)")
    return (f"prints the joints that a leader commands: J1 {said[-1]:g}", abs(said[-1] - 10) <= 0.3
            and not s.data(0x2A5))


def leaders_mode(s):
    return ("prints the mode that a leader commands: CAN, move J",
            "ctrl_mode : 1" in s.out and "move_mode : 1" in s.out and not s.data(0x2A5))


def response(s):
    return ("0x476 for 0x71 after 0x471; the demo ends by itself",
            (0x71, 0) in s.acknowledged() and s.code == 0)


def tool_point(s):
    said = re.findall(r"X: (-?\d+), Y: (-?\d+), Z: (-?\d+)", s.out)[-1]
    return f"prints the tool point, z = {said[2]} um", abs(int(said[2])) > 1000


def frames_per_second(s):
    totals = s.numbers(r"all_fps: ([\d.]+)")
    return (f"an SLCAN port is asked for, given the same bus: {totals[-1]:.0f} frames per second",
            abs(totals[-1] - 3040) <= 304)


def gripper_zero(s):
    return (f"opening from {max(s.opening()):.1f} to {s.opening()[-1]:.1f} mm, nothing moved by the motor",
            max(s.opening()) > 25 and abs(s.opening()[-1]) <= 1)


def defaults(s):
    first, last = ([int.from_bytes(d[5:7], "big") for d in s.answers(0x473) if d[0] == 1][i] for i in (0, -1))
    return (f"0x476 for 0x77, 0x478; J1's speed, written to 150, answers {last} again",
            (0x77, 0) in s.acknowledged() and last == 300 and len(s.answers(0x478)) == 1)


def joint_zero(s):
    zeroed = [t for t, d in s.at(0x476) if d[0] == 0x75 and d[1] == 1]
    if not zeroed:
        return f"no zero set: {s.acknowledged()[-3:]}", False
    q6 = [(t - zeroed[0], int32(d, 4) / 1e3) for t, d in s.at(0x2A7)]
    before, after = [q for t, q in q6 if t < -0.02][-1], [q for t, q in q6 if 0.02 < t < 0.06][0]
    return (f"J6 loses its power, 0x476 says that its zero is set, it reads {before:.0f} degrees before and {after:.1f} "
            "after, gets its power again", abs(after) <= 0.5 and abs(before) > 30 and all(s.enabled()))


def load(s):
    return "0x476 for 0x77; a load changes nothing here", (0x77, 0) in s.acknowledged()


def leader(s):
    since = next(t for t, d in s.at(0x476) if d[0] == 0x70)
    silent = not any(s.data(i, since + 0.02) for i in range(0x2A1, 0x2A9))
    return (f"0x476 for 0x70; silent on 0x2A1 to 0x2A8, sends {len(s.data(0x155))} frames 0x155",
            silent and len(s.data(0x155)) > 100)


def follower(s):
    commands = s.at(0x155)[-1][0]
    return ("0x476 for 0x70; 0x2A1 to 0x2A8 again, no more 0x155",
            len(s.data(0x2A5, commands + 0.1)) > 100)


def direct_mode(s):
    return ("0x151 with 0xAD: control CAN, move J reported; speed 0, nothing moves",
            s.data(0x151)[-1][3] == 0xAD and tuple(s.data(0x2A1)[-1][i] for i in (0, 2)) == (1, 1)
            and max(s.joint(1)) - min(s.joint(1)) < 0.1)


def limit_writes(s):
    last = {d[0]: (int16(d, 1), int16(d, 3)) for d in s.answers(0x473)}
    wanted = {1: (1500, -1500), 2: (1800, 0), 3: (0, -1700), 4: (1000, -1000), 5: (700, -700), 6: (1700, -1700)}
    return "six 0x476 for 0x74; 0x473 answers what was written", last == wanted and s.acknowledged().count((0x74, 0)) == 6


def sdk_limits(s):
    return "limits inside the SDK only: prints J6 to 2.09 rad, gripper to 0.05 m", "2.09" in s.out and "0.05" in s.out


def disconnect(s):
    counted = s.numbers(r"can: ([\d.]+)")
    return (f"{counted[150]:.0f} frames per second, {min(counted[250:]):.0f} while disconnected, "
            f"{counted[-1]:.0f} connected again",
            abs(counted[150] - 3040) <= 400 and min(counted[250:]) < 100 and abs(counted[-1] - 3040) <= 400)


def two_instances(s):
    said = [float(x) for x in re.findall(r"^([\d.]+)$", s.out, re.M)]
    return f"two names, one bus here: {said[-1]:.0f} frames per second", abs(said[-1] - 3040) <= 304


# demo: (seconds, judge, {prepare, options of the emulator, lines typed (one per 0.7 s), then: asked at the end})
POSE = ["--start-deg", "10,40,-30,10,10,10"]
TURNED = ["--start-deg", "0,0,0,0,0,100"]
DEMOS = {
    "V2_piper_ctrl_joint_mit": (5, torque_mode, {}),
    "V2_piper_ctrl_motor_max_spd": (4, speed_write, {}),
    "V2_piper_read_gripper_param_feedback": (3, gripper_parameters, {}),
    "V2_piper_set_gripper_param": (3, gripper_write, {}),
    "V2_piper_set_installation_pos": (3, installation, {}),
    "piper_ctrl_disable": (3, disable, {"prepare": lift}),
    "piper_ctrl_enable": (3, enable, {}),
    "piper_ctrl_end_pose": (10, pose_moves, {}),
    "piper_ctrl_go_zero": (6, zero_pose, {"options": POSE}),
    "piper_ctrl_gripper": (6, gripper_moves, {}),
    "piper_ctrl_joint": (6, joint_moves, {}),
    "piper_ctrl_line": (12, line_moves, {}),
    "piper_ctrl_moveC": (14, arc, {}),
    "piper_ctrl_moveJ": (6, joint_moves, {}),
    "piper_ctrl_moveL": (13, square, {}),
    "piper_ctrl_moveP": (10, pose_moves, {}),
    "piper_ctrl_reset": (3, reset, {"prepare": lambda bus: (lift(bus), bus.say(0x150, 1), time.sleep(0.2))}),
    "piper_ctrl_stop": (4, stop, {"prepare": lift}),
    "piper_read_all_fps": (5, rates, {}),
    "piper_read_arm_motor_max_acc_limit": (3, accelerations, {}),
    "piper_read_arm_motor_max_angle_spd": (3, speeds, {}),
    "piper_read_crash_protectation": (3, crash, {}),
    "piper_read_end_pose": (3, prints_pose, {"options": POSE}),
    "piper_read_firmware": (3, firmware, {}),
    "piper_read_fk": (3, forward_kinematics, {"options": POSE}),
    "piper_read_gripper_status": (3, prints(r"grippers_angle:\s*(29|30)", "prints 30 mm, as opened before"),
                                  {"prepare": open_gripper}),
    "piper_read_high_msg": (3, prints(r"motor_speed", "prints speeds, currents, efforts of six motors"), {}),
    "piper_read_joint_ctrl": (3, leaders_targets, {"options": POSE, "prepare": lead}),
    "piper_read_joint_state": (3, prints(r"Joint 2:(39|40)\d\d\d", "prints J2 at 40 degrees, where it stands"),
                               {"options": POSE}),
    "piper_read_low_msg": (3, prints(r"vol\s*:\s*240", "prints 24.0 V of six drivers"), {}),
    "piper_read_mode_ctrl": (3, leaders_mode, {"prepare": lead}),
    "piper_read_mode_ctrl_canid_151": (3, leaders_mode, {"prepare": lead}),
    "piper_read_resp_instruction": (7, response, {}),
    "piper_read_status": (3, prints(r"NORMAL", "prints standby, normal"), {}),
    "piper_read_tcp_pose": (3, tool_point, {"options": POSE}),
    "piper_read_version": (3, firmware, {}),
    "piper_set_can": (4, frames_per_second, {}),
    "piper_set_gripper_zero": (5, gripper_zero, {"prepare": open_gripper}),
    "piper_set_init_default": (3, defaults, {"prepare": slow_joint_1}),
    "piper_set_joint_zero": (6, joint_zero, {"options": TURNED, "typed": ["0", "6", "", "q", "q"]}),
    "piper_set_joint_zero_cpv": (6, joint_zero, {"options": TURNED, "typed": ["0", "6", "", "q", "q"]}),
    "piper_set_load": (3, load, {}),
    "piper_set_log_level": (3, prints(r"log file path: \S", "prints its log's path; nothing on the bus"), {}),
    "piper_set_master": (3, leader, {}),
    "piper_set_mit": (3, direct_mode, {}),
    "piper_set_motor_angle_limit": (4, limit_writes, {"then": ask_limits}),
    "piper_set_motor_max_acc_limit": (7, acceleration_write, {}),
    "piper_set_sdk_param": (3, sdk_limits, {}),
    "piper_set_slave": (3, follower, {"prepare": lead}),
    "piper_test_interface_disconnect": (14, disconnect, {}),
    "piper_test_multi_interface_instance": (5, two_instances, {}),
}


def run(program, folder, name):
    seconds, judge, more = DEMOS[name]
    emulator = subprocess.Popen([program, "--bus", f"udp:{GROUP}:{PORT}", *more.get("options", [])],
                                stdout=subprocess.PIPE, text=True)
    emulator.stdout.readline()
    bus = Bus()
    try:
        time.sleep(0.3)
        more.get("prepare", lambda _: None)(bus)
        since = time.monotonic()
        with tempfile.TemporaryFile("w+") as out:
            demo = subprocess.Popen([sys.executable, "-u", __file__, "--launch", f"{folder}/{name}.py"], stdin=subprocess.PIPE,
                                    stdout=out, stderr=subprocess.STDOUT, text=True)
            for line in more.get("typed", []):
                time.sleep(0.7)
                if demo.poll() is None:
                    demo.stdin.write(line + "\n")
                    demo.stdin.flush()
            time.sleep(max(0, since + seconds - time.monotonic()))
            code = demo.poll()
            if code is None:
                demo.send_signal(signal.SIGKILL)
                demo.wait()
            more.get("then", lambda _: None)(bus)
            out.seek(0)
            said = out.read()
    finally:
        bus.close()
        emulator.kill()
        emulator.wait()
    seen = Seen(bus.frames, since, said, code)
    try:
        text, right = judge(seen)
    except Exception as error:  # a judge that finds nothing to judge
        text, right = f"not judged: {type(error).__name__} {error}", False
    if not right:
        print(f"--- {name} printed at the end:\n{said[-600:]}\n---", flush=True)
    return text, right


def main():
    if sys.argv[1] == "--launch":
        launch(sys.argv[2])
        return
    program, *rest = sys.argv[1:]
    write = rest.pop(1) if rest[:1] == ["--write"] else None
    if write:
        rest.pop(0)
    import piper_sdk
    folder = os.path.join(os.path.dirname(piper_sdk.__file__), "demo", "V2")
    there = {f[:-3] for f in os.listdir(folder) if f.endswith(".py") and f != "__init__.py"}
    if there != set(DEMOS):
        sys.exit(f"the checkout's demos are others than those of piper_sdk 0.6.1: {sorted(there ^ set(DEMOS))}")
    lines, wrong = ["| demo | effect | |", "|---|---|---|"], 0
    for name in rest or DEMOS:
        text, right = run(program, folder, name)
        wrong += not right
        print(f"{'ok  ' if right else 'FAIL'} {name:38s} {text}", flush=True)
        lines.append(f"| `{name}` | {text} | {'right' if right else '**wrong**'} |")
    print(f"{len(lines) - 2 - wrong} of {len(lines) - 2} demos have the effect that they should")
    if write:
        with open(write) as file:
            before, _, after = file.read().split(MARK)
        with open(write, "w") as file:
            file.write(before + MARK + "\n" + "\n".join(lines) + "\n" + MARK + after)
    sys.exit(min(wrong, 70))


main()
