#!/usr/bin/env python3
"""What happens when a driver, its arm or the client fails in mid-motion, in real time.

    mishaps.py BUILD_DIR OUT_DIR [--patient] [ONLY]      ONLY: a regular expression of names

Each row is a run of robot_client against emulated_driver.py and joint_policy_server. Prints a
Markdown table: the state and its cause, the seconds from the mishap to that state, to the last change
of the arm's target, and to the arm's rest (within 5 mrad of where it stays). Exit code 1 where a row
is not what it should be. What the driver did is in OUT_DIR/NAME.log: t, target and position of joint
2 in its own unit, flags. A row that a busy machine ended before its
mishap is played again, three times in all. --patient: the guards of silence wait longer.
"""

import csv
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time

HERE = os.path.dirname(os.path.abspath(__file__))
REST = 0.005  # [rad]
TYPED = "stop_is_not_obeyed"  # a person is there: alone, the client ends in FAULT at once
EVENT = re.compile(r'"monotonic_ns":(\d+)')


def rows():
    """name, driver's options, what is done in mid-motion, the state and causes that must follow."""
    kill, stop = signal.SIGKILL, signal.SIGSTOP
    yield "driver_killed", [], ("driver", kill), "FAULT", "arm_fault"
    yield "driver_stopped", [], ("driver", stop), "HOLD", "arm_silent"
    yield "driver_stops_1_s", ["--fault", "stall:1@2"], None, "HOLD", "arm_silent"
    yield "driver_silent", ["--fault", "silent@2"], None, "HOLD", "arm_silent"
    yield "states_late_0.2_s", ["--fault", "late:0.2@2"], None, "HOLD", "arm_silent"
    yield "old_frame_again", ["--fault", "replay@2"], None, "HOLD", "arm_silent"
    yield "old_state_new_stamps", ["--fault", "restamp@2"], None, "HOLD|FAULT", "blocked|following_error"
    yield "jump", ["--fault", "jump:30@2"], None, "HOLD", "arm_silent"
    yield "nan", ["--fault", "nan@2"], None, "FAULT", "arm_fault"
    yield "value_too_few", ["--fault", "count@2"], None, "FAULT", "arm_fault"
    yield "garbage", ["--fault", "garbage@2"], None, "FAULT", "arm_fault"
    yield "other_version", ["--fault", "version@2"], None, "FAULT", "arm_fault"
    yield "read_raises", ["--fault", "raises@2"], None, "HOLD|FAULT", "arm_silent|arm_fault"
    yield "joints_lose_power", ["--fault", "unpowered@2"], None, "FAULT", "arm_disabled"
    yield "collision", ["--fault", "collision@2"], None, "FAULT", "arm_fault"
    yield "joints_blocked", ["--fault", "blocked@2"], None, "HOLD", "blocked"
    yield "server_killed", [], ("server", kill), "HOLD", "server_silent"
    yield "operator_holds", [], ("client", signal.SIGINT), "HOLD", "operator"
    yield "operator_stops_twice", [], ("client", "twice"), "FAULT", "quick_stop"
    yield TYPED, ["--fault", "deafstop"], ("client", "twice"), "FAULT", "quick_stop"
    yield "client_killed", [], ("client", kill), "", ""
    yield "client_stopped", [], ("client", stop), "", ""
    yield "flood", ["--fault", "flood@1"], None, "", ""
    seven = ["--arm", "seven"]
    yield "seven_joints_driver_killed", seven, ("driver", kill), "FAULT", "arm_fault"
    yield "seven_joints_jump", [*seven, "--fault", "jump:0.5@2"], None, "HOLD", "arm_silent"
    yield "seven_joints_blocked", [*seven, "--fault", "blocked@2"], None, "HOLD", "blocked"
    yield "seven_joints_hold", seven, ("client", signal.SIGINT), "HOLD", "operator"
    yield "seven_joints_client_killed", seven, ("client", kill), "", ""


class Run:
    patient = False

    def __init__(self, build, out, name, driver_options, robot=None):
        self.out, self.name = os.path.join(out, name), name
        self.socket = f"/tmp/bridge-{os.getpid()}"
        self.files = []
        log = self.out + ".log"
        seven = "seven" in driver_options
        robot = robot or f"{HERE}/{'seven_joints' if seven else 'five_servos'}.yaml"
        self.driver = self.start("driver", [sys.executable, f"{HERE}/emulated_driver.py", "--socket",
                                            self.socket, "--log", log, *driver_options])
        self.server = self.start("server", [f"{build}/test_bin/joint_policy_server", "--axes", "8" if seven else "6"])
        address = self.wait_for("server", r"joint_policy_server: (\S+)")
        self.wait_for("driver", " at /tmp/")
        self.client = self.start("client", [
            f"{build}/bin/robot_client", "--arm", f"bridge:unix:{self.socket}", "--robot",
            robot, "--server", address, "--policy", "sway", "--instruction", "sway",
            "--camera", "base=synthetic", "--camera", "wrist=synthetic", "--set",
            "episodes=1", "--set", "episode_s=6", "--set", "realtime.priority=0", "--set",
            "realtime.lock_memory=false", "--set", "control.watchdogs.server_hold_s=0.5", "--out", self.out,
            *(["--set", "control.watchdogs.arm_hold_s=0.15", "--set", "control.watchdogs.arm_fault_s=0.5"]
              if self.patient else []),
            *([] if name == TYPED or name.startswith("run") else ["--automatic"])])
        if name == TYPED:
            for order, answer in (("enable", "the arm has power"), ("start", "episode 0")):
                self.type(order)
                self.wait_for("client", answer)
        # Dead or dying, all of them are ended; what they say stays in the files.

    def start(self, what, command):
        file = open(f"{self.out}.{what}", "w")
        self.files.append(file)
        return subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, stdin=subprocess.PIPE)

    def type(self, order):
        self.client.stdin.write(order.encode() + b"\n")
        self.client.stdin.flush()

    def text(self, what):
        with open(f"{self.out}.{what}") as file:
            return file.read()

    def wait_for(self, what, pattern, seconds=20):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            found = re.search(pattern, self.text(what))
            if found:
                return found.group(found.lastindex or 0)
            time.sleep(0.02)
        raise SystemExit(f"{self.name}: the {what} does not say '{pattern}':\n{self.text(what)}")

    def end(self):
        for process in (self.client, self.driver, self.server):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()
        for file in self.files:
            file.close()


def play(build, out, name, options, act):
    """Runs the row; (time of the mishap [s, monotonic], exit code of the client or None)."""
    run = Run(build, out, name, options)
    try:
        run.wait_for("client", r"RUN \(operator\)")
        begun = time.monotonic()
        time.sleep(2.0)
        at = time.monotonic()
        if act and act[1] == "twice":
            run.client.send_signal(signal.SIGINT)
            time.sleep(0.1)
            run.client.send_signal(signal.SIGINT)
        elif act:
            getattr(run, act[0]).send_signal(act[1])
        if act and act[0] == "client" and act[1] in (signal.SIGKILL, signal.SIGSTOP):
            time.sleep(1.5)
            return run, at, None
        # What the emulated driver does at second 2 of its arm's power is seen in the record.
        if name == TYPED:
            time.sleep(2)
            run.type("quit")
        code = run.client.wait(timeout=30)
        if name == "driver_stops_1_s":
            time.sleep(1)  # it has slept over the client's end
        return run, at if act else begun, code
    finally:
        run.end()


def record(out, name):
    """The rows of ticks.csv with floats where there are numbers, and the record's origin [s]."""
    folder = os.path.join(out, name)
    path = os.path.join(folder, "ticks.csv")
    path = path if os.path.exists(path) else path + ".partial"
    with open(path) as file:
        ticks = list(csv.DictReader(file))
    with open(os.path.join(folder, "events.jsonl")) as file:
        origin = int(EVENT.search(file.read()).group(1)) / 1e9
    return ticks, origin


def driver_log(out, name):
    with open(os.path.join(out, name + ".log")) as file:
        lines = [line.split() for line in file if line.endswith("\n")]
    unit = 1.0 if name.startswith("seven") else math.radians(1)
    return [(float(t), unit * float(target), unit * float(at), int(flags)) for t, target, at, flags in lines]


def judge(out, name, mishap, state, cause):
    """(line of the table, what is wrong or None)."""
    ticks, origin = record(out, name)
    log = driver_log(out, name)
    running = [i for i, tick in enumerate(ticks) if tick["state"] == "RUN"]
    stopped = [t for t in ticks[running[0] :] if t["state"] != "RUN"] if running else []
    fits = [t for t in stopped if re.fullmatch(state, t["state"]) and re.fullmatch(cause, t["cause"])]
    left = (fits or stopped or [None])[0]
    told = f"{left['state']} ({left['cause']})" if left else "RUN"
    now = origin + float(left["t"]) if left else None
    wrong = None
    if state and not fits:
        wrong = f"{name}: {told}, must be {state} ({cause})"
    early = [t for t in stopped if origin + float(t["t"]) < mishap - 0.05]
    if early:
        wrong = f"{name}: {early[0]['state']} ({early[0]['cause']}) before the mishap"
    after = [entry for entry in log if entry[0] >= mishap]
    seen = "not seen"
    moved = "not seen"
    if after:
        end_target, end_position = log[-1][1], log[-1][2]
        changes = [t for t, target, _, _ in after if abs(target - end_target) > math.radians(0.02)]
        moves = [t for t, _, at, _ in after if abs(at - end_position) > REST]
        moved = f"{max(0.0, (changes[-1] if changes else mishap) - mishap):.2f}"
        seen = f"{max(0.0, (moves[-1] if moves else mishap) - mishap):.2f}"
    reached = f"{max(0.0, now - mishap):.2f}" if now else ""
    return f"| {name} | {told} | {reached} | {moved} | {seen} |", wrong


def mishap_of(out, name, at, act, fault_at):
    """Of the emulated driver's own: `fault_at` seconds after it obeyed the first enable."""
    if act:
        return at
    first = next(t for t, _, _, flags in driver_log(out, name) if flags & 2)
    return first + fault_at


def client_fails(out, name, at):
    """The driver holds the arm when its client is killed or stopped, and how soon."""
    log = driver_log(out, name)
    held = next((t for t, _, _, flags in log if flags & 4 and t >= at), None)
    if held is None:
        return f"| {name} | not held | | | |", f"{name}: the driver did not hold"
    end = log[-1][2]
    rest = max([t for t, _, p, _ in log if abs(p - end) > REST and t >= at], default=at) - at
    line = f"| {name} | the driver holds | {held - at:.2f} | {held - at:.2f} | {rest:.2f} |"
    most = 0.1 if "client_killed" in name else 0.4
    return line, None if held - at < most and rest < 1 else f"{name}: held after {held - at:.2f} s"


def row(build, out, name, options, act, state, cause):
    """Plays it; (line of the table, what is wrong or None)."""
    shutil.rmtree(os.path.join(out, name), ignore_errors=True)
    run, at, code = play(build, out, name, options, act)
    if "client_" in name:
        return client_fails(out, name, at)
    fault = re.search(r"@([\d.]+)", " ".join(options))
    mishap = mishap_of(out, name, at, act, float(fault.group(1)) if fault else 0.0)
    line, complaint = judge(out, name, mishap, state, cause)
    if name == "flood" and code != 0:
        complaint = f"{name}: exit code {code}: {run.text('client')}"
    if name == TYPED and "use the switch" not in run.text("client"):
        complaint = f"{name}: not shown: {run.text('client')}"
    return line, complaint


def greetings(build, out):
    """Who is not let in: a second client, no driver, a driver of another version, one that can less."""
    def client(socket, *options, robot=f"{HERE}/five_servos.yaml", arm="bridge:unix:"):
        done = subprocess.run(
            [f"{build}/bin/robot_client", "--arm", f"{arm}{socket}", *(["--robot", robot] if robot else []),
             "--set", "realtime.priority=0", "--set", "realtime.lock_memory=false", "--out", f"{out}/none", *options],
            input="quit\n", capture_output=True, text=True, timeout=60)
        return done.returncode, done.stdout + done.stderr

    complaints = []

    def expect(name, result, code, *words):
        if result[0] != code or any(word not in result[1] for word in words):
            complaints.append(f"{name}: exit code {result[0]}, {result[1]}")
        print(f"| {name} | exit code {result[0]} | | | |", flush=True)

    shutil.rmtree(f"{out}/none", ignore_errors=True)
    expect("no_driver", client(f"/tmp/nobody-{os.getpid()}"), 2, "no driver at unix:", "start it first")
    shutil.rmtree(f"{out}/second_client", ignore_errors=True)
    nobody = "/tmp/nobody"
    so101 = f"{HERE}/../../../robot_client/bridge/so101.yaml"
    expect("automatic_on_a_real_arm", client(nobody, "--automatic", robot=so101), 2, "started by a person")
    expect("no_robot_file", client(nobody, robot=None), 2, "give --robot FILE")
    expect("robot_file_missing", client(nobody, robot="/tmp/none.yaml"), 2, "/tmp/none.yaml")
    expect("robot_file_without_bridge", client("rehearse", arm=""), 2, "leave --robot out")
    expect("address_of_another_kind", client(":5000", arm="bridge:tcp"), 2, "must be bridge:unix:PATH")
    run = Run(build, out, "second_client", [])
    try:
        run.wait_for("client", r"RUN \(operator\)")
        expect("second_client", client(run.socket), 2, "another client drives this arm")
        if run.client.wait(timeout=30) != 0:
            complaints.append("second_client: the first one was disturbed: " + run.text("client"))
    finally:
        run.end()
    for name, options, words in (
        ("driver_cannot_power_off", ["--cannot", "can_power_off"], "expects: torque_off"),
        ("driver_does_nothing", ["--on-silence", "nothing"], "it does nothing when this client is silent"),
        ("driver_waits_long", ["--watchdog-s", "1.5"], "it waits 1.5 s, at most 0.5 s"),
        ("driver_is_real", ["--cannot", "simulated"], "its arm is real"),
        ("driver_of_version_2", ["--fault", "version"], "another version"),
    ):
        socket = f"/tmp/bridge-{os.getpid()}-{name}"
        with open(f"{out}/{name}.driver", "w") as file:
            driver = subprocess.Popen([sys.executable, f"{HERE}/emulated_driver.py", "--socket", socket, *options],
                                      stdout=file, stderr=subprocess.STDOUT)
        try:
            expect(name, client(socket), 2, words)
        finally:
            driver.terminate()
            driver.wait()
    return complaints


def main():
    words = [word for word in sys.argv[1:] if word != "--patient"]
    Run.patient = len(words) < len(sys.argv) - 1
    build, out = os.path.abspath(words[0]), os.path.abspath(words[1])
    only = words[2] if len(words) > 2 else ""
    os.makedirs(out, exist_ok=True)
    wrong = []
    print("| mishap | state (cause) | state after [s] | target at rest after [s] | arm at rest after [s] |")
    print("|---|---|---:|---:|---:|")
    for name, options, act, state, cause in rows():
        if not re.search(only, name):
            continue
        for _ in range(3):
            line, complaint = row(build, out, name, options, act, state, cause)
            if not complaint:
                break
        print(line, flush=True)
        wrong += [complaint] if complaint else []
    if not only or re.search(only, "greetings"):
        wrong += greetings(build, out)
    for complaint in wrong:
        print("WRONG " + complaint)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
