#!/usr/bin/env python3
"""Goes through docs/drive-an-arm.md with the real programs against an emulated arm.

  unshare -rn tests/robot_client/first_day.py BUILD_DIR OUT_DIR [--no-policy] [--write]

Types what the page says, in real time, over UDP on the loopback interface of a network namespace of
its own, and fails when a command fails, when an expected line does not come, or when the page has
other commands. --write puts what came out between the page's marks (<!-- step NAME -->).
--no-policy leaves out the steps that need the policy server, as a build without LibTorch does.
Exit codes: 0 all steps went well; 1 one did not; 77 there is no such namespace.
"""

import json
import os
import queue
import re
import signal
import subprocess
import sys
import threading
import time

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
PAGE = os.path.join(ROOT, "docs", "drive-an-arm.md")
PATIENCE_S = 60
HOLDS = ("arm_silent", "send_failed", "(delayed)")  # of a machine that is too busy for real time


class Failed(Exception):
    pass


class Program:
    """A command whose output is waited for and that is typed to."""

    def __init__(self, day, command):
        self.command, self.lines, self.seen = command, ["$ " + command], 1
        self.process = subprocess.Popen(
            ["bash", "-c", "exec " + command], cwd=day.out, env=day.environment, text=True,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        self.output = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.output.put(line.rstrip("\n"))
        self.output.put(None)

    def wait_for(self, expected):
        """The rest of the output up to a line that matches; lines before it are kept."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            while self.seen < len(self.lines):
                self.seen += 1
                if re.search(expected, self.lines[self.seen - 1]):
                    return
            try:
                line = self.output.get(timeout=max(0.01, deadline - time.monotonic()))
            except queue.Empty:
                line = None
            if line is None:
                raise Failed(f"'{self.command}': no line with '{expected}' came:\n" +
                             "\n".join(self.lines))
            self.lines.append(line)

    def _came(self):
        """What has come so far stands before what is typed next."""
        while not self.output.empty():
            line = self.output.get()
            if line is None:
                raise Failed(f"'{self.command}' has ended:\n" + "\n".join(self.lines))
            self.lines.append(line)

    def type(self, text):
        self._came()
        self.lines.append("> " + (text or "(Enter)"))
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()

    def interrupt(self):
        self._came()
        self.lines.append("> (Ctrl-C)")
        self.process.send_signal(signal.SIGINT)

    def end(self, expected_code=0):
        self.process.stdin.close()
        while (line := self.output.get(timeout=PATIENCE_S)) is not None:
            self.lines.append(line)
        code = self.process.wait(PATIENCE_S)
        if code != expected_code:
            raise Failed(f"'{self.command}' ended with {code}, not {expected_code}:\n" +
                         "\n".join(self.lines))
        return self.lines


def readable(lines):
    """Without the list of orders, which every start prints, and without what depends on the machine."""
    if not any(line.startswith("Orders, one a line") for line in lines):
        return lines
    text = []
    for line in lines:
        if line.startswith("Orders, one a line"):
            text.append("Orders, one a line ...")
        elif line and not line.startswith("control thread:") and not re.match("  [a-z]", line):
            text.append(line)
    return text


def shortened(lines):
    """A page of the monitor without its inner joints, limits and rates."""
    second = next(i for i, line in enumerate(lines) if line.startswith("J2 "))
    gripper = next(i for i, line in enumerate(lines) if line.startswith("gripper "))
    warning = next(i for i, line in enumerate(lines) if line.startswith("WARNING "))
    return lines[:second] + ["..."] + lines[gripper - 1:gripper + 1] + ["..."] + lines[warning:]


class Day:
    def __init__(self, build, out):
        self.out, self.steps, self.server = out, {}, None
        os.makedirs(out, exist_ok=True)
        self.environment = dict(os.environ, PATH=f"{build}/bin:" + os.environ["PATH"],
                                OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
        with open(os.path.join(ROOT, "robot_client", "lab.yaml"), encoding="utf-8") as file:
            text = file.read()
        # What differs from the day with an arm: its bus, and pictures without a camera.
        text, bus = re.subn(r"can:can0 ", "udp:239.74.163.2:43113 ", text, count=1)
        text, cameras = re.subn(r"v4l2:\S+", "synthetic", text)
        if (bus, cameras) != (1, 2):
            raise Failed("lab.yaml has no bus can:can0 or not two cameras v4l2:...")
        with open(os.path.join(out, "lab.yaml"), "w", encoding="utf-8") as file:
            file.write(text)

    def emulator(self, *options):
        process = subprocess.Popen(["piper_emulator", *options], env=self.environment, text=True,
                                   stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
        process.stdout.readline()  # it says where it listens, then goes on
        return process

    def step(self, name, act, *options):
        for attempt in range(1, 6):
            arm = self.emulator(*options)
            subprocess.run("rm -rf runs/" + name, shell=True, cwd=self.out, check=True)
            try:
                self.steps[name] = readable(act(self))
                print(f"{name}: well")
                return
            except Failed as failed:
                if attempt == 5 or not any(hold in str(failed) for hold in HOLDS):
                    raise
                print(f"{name}: the machine was too busy, once more")
            finally:
                arm.terminate()
                arm.wait()


def ready(program, line):
    """It has started, as `line` says, and listed its orders."""
    program.wait_for(line)
    program.wait_for("^  quit limp")


def look(day):
    program = Program(day, "robot_client monitor --config lab.yaml --once")
    for line in ("firmware S-V1.8-9, control standby, status normal", "of 3040 frames per second",
                 "15 of 15 answered", "^J6 ", "WARNING .*collision protection is off",
                 "well: nothing is wrong"):
        program.wait_for(line)
    return shortened(program.end())


def moves(day):
    program = Program(
        day, "robot_client --config lab.yaml --set cameras=[] --out runs/moves")
    program.wait_for("collision protection, J1 to J6: 5 5 5 5 5 5")
    ready(program, "firmware S-V1.8-9; no policy server")
    for order, answer in (("enable", "the arm has power and holds"),
                          ("jog J3 -5deg", "the arm is there, "),
                          ("jog J1 5deg", "the arm is there, "),
                          ("home", "the arm is home, ")):
        program.type(order)
        program.wait_for(answer)
    time.sleep(0.3)
    program.type("quit")
    return program.end()


def drills(day):
    program = Program(
        day, "robot_client --config lab.yaml --set cameras=[] --out runs/drills")
    ready(program, "no policy server")
    program.type("enable")
    program.wait_for("the arm has power and holds")
    program.type("home")
    program.wait_for("MOVE")
    time.sleep(2)
    program.type("")
    program.wait_for("ENABLED")
    time.sleep(2)  # a person looks at the arm first
    program.type("home")
    program.wait_for("MOVE")
    time.sleep(2)
    program.interrupt()
    program.wait_for("ENABLED")
    time.sleep(4)  # two presses within 3 s are a pair
    program.type("home")
    program.wait_for("MOVE")
    time.sleep(2)
    program.interrupt()
    time.sleep(0.2)
    program.interrupt()
    program.wait_for(r"FAULT \(quick_stop\)")
    time.sleep(2)
    program.type("clear")
    program.wait_for("refused|no fault")
    program.type("quit limp")
    return program.end()


def rehearsal(day):
    program = Program(day, "robot_client --config lab.yaml --bus rehearse --server 127.0.0.1:50051 "
                           "--out runs/rehearsal")
    ready(program, r"cameras \[base, wrist\]")
    for order, answer in (("enable", "^the arm has power and holds"), ("start", r"RUN \(operator\)")):
        program.type(order)
        program.wait_for(answer)
    time.sleep(3)
    program.type("success")
    program.wait_for("episode ended")
    program.type("quit")
    return program.end()


def motion(day):
    # In a second terminal, as the page has it: the client must not mind.
    with open(os.path.join(day.out, "monitor.jsonl"), "w", encoding="utf-8") as reports:
        monitor = subprocess.Popen("robot_client monitor --config lab.yaml --json".split(),
                                   cwd=day.out, env=day.environment, stdout=reports)
    program = Program(day, "robot_client --config lab.yaml --server 127.0.0.1:50051 "
                           "--set episode_s=5 --out runs/motion")
    ready(program, r"cameras \[base, wrist\]")
    for order, answer in (("enable", "^the arm has power and holds"), ("home", "the arm is home"),
                          ("start", r"RUN \(operator\)")):
        program.type(order)
        program.wait_for(answer)
    time.sleep(2)
    program.type("")
    program.wait_for(r"HOLD \(operator\)")
    program.type("resume")
    program.wait_for(r"RUN \(operator\)")
    program.wait_for("episode ended")
    program.type("quit")
    lines = program.end()
    monitor.send_signal(signal.SIGINT)
    code = monitor.wait(PATIENCE_S)
    with open(os.path.join(day.out, "monitor.jsonl"), encoding="utf-8") as file:
        reports = [json.loads(line) for line in file]
    moving = [report for report in reports if report["other_commands_now"]]
    if code != 0 or len(moving) < 10 or any(report["asking"] for report in moving):
        raise Failed(f"monitor ended with {code}, saw {len(moving)} of {len(reports)} reports with "
                     f"commands, the last: {reports[-1:]}")
    return lines


def policy(day):
    """Serves the repository's policy; the server stays until the end."""
    day.server = Program(day, "robostress serve --policy nano-piper --listen 127.0.0.1:50051")
    day.server.wait_for("serving nano-piper")
    return day.server.lines[:2]


def commands(lines):
    return [line for line in lines if line.startswith(("$ ", "> "))]


def compare_or_write(steps, write):
    with open(PAGE, encoding="utf-8") as file:
        page = file.read()
    for name, lines in steps.items():
        mark = re.compile(rf"(<!-- step {name} -->\n```\n)(.*?)(```\n<!-- /step -->)", re.S)
        found = mark.search(page)
        if not found:
            raise Failed(f"{PAGE} has no step {name}")
        if write:
            text = "\n".join(lines) + "\n"
            page = mark.sub(lambda match: match.group(1) + text + match.group(3), page)  # noqa: B023
        elif commands(found.group(2).splitlines()) != commands(lines):
            raise Failed(f"{PAGE}, step {name}: its commands are not those that were run; write it "
                         "anew with --write")
    if write:
        with open(PAGE, "w", encoding="utf-8") as file:
            file.write(page)


def main():
    arguments = [argument for argument in sys.argv[1:] if not argument.startswith("--")]
    if len(arguments) != 2:
        sys.exit(__doc__)
    build, out = map(os.path.abspath, arguments)
    for command in ("ip link set lo up", "ip route add 224.0.0.0/4 dev lo"):
        if subprocess.run(command.split(), check=False).returncode != 0:
            print("no network namespace of its own: start it with unshare -rn")
            sys.exit(77)
    subprocess.run(["rm", "-rf", out], check=True)
    try:
        day = Day(build, out)
        day.step("look", look)
        day.step("moves", moves)
        day.step("drills", drills)
        if "--no-policy" not in sys.argv:
            day.step("policy", policy)
            day.step("rehearsal", rehearsal)
            day.step("motion", motion)
        compare_or_write(day.steps, "--write" in sys.argv)
    except Failed as failed:
        print(failed)
        sys.exit(1)
    finally:
        if "day" in locals() and day.server:
            day.server.process.terminate()


if __name__ == "__main__":
    main()
