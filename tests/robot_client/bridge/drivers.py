#!/usr/bin/env python3
"""The drivers of deploy/ with robot_client: a person enables, jogs, drives home, stops and goes on.

    drivers.py ros2 BUILD_DIR OUT_DIR           rclpy is a stand-in: ROS 2 is on no package index
    drivers.py lerobot BUILD_DIR OUT_DIR VENV   LeRobot's own SO-101 on an emulated servo bus, and a
                                                Robot of its base class; 77 where it cannot be installed
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

HERE = os.path.dirname(os.path.abspath(__file__))
DEPLOY = os.path.join(HERE, "../../../deploy")
LEROBOT = "lerobot==0.4.4"  # of Python 3.10 and newer

TWO = """
name: two
joints:
  - {name: a, unit: UNIT, lower: -1.5, upper: 1.5, velocity: 1, acceleration: 8}
  - {name: b, unit: UNIT, lower: -1.5, upper: 1.5, velocity: 1, acceleration: 8}
gripper: {name: jaw, JAW, lower: 0, upper: 0.08, velocity: 0.2, acceleration: 4}
home: [0.3, -0.2, 0.05]
simulated: true
driver: {on_silence: true}
"""


class Driver:
    """A driver process; ended with this, by SIGTERM, which must be an orderly end."""

    def __init__(self, out, name, command, environment=None):
        self.socket, self.log = f"/tmp/bridge-{os.getpid()}-{name}", os.path.join(out, name + ".driver")
        with open(self.log, "w") as file:
            self.process = subprocess.Popen(
                [*command, "--socket", self.socket, "--simulated", "--watchdog-s", "0.5"], stdout=file,
                stderr=subprocess.STDOUT, env={**os.environ, **(environment or {})})
        end = time.monotonic() + 60
        while not os.path.exists(self.socket):
            if self.process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"{name} does not listen:\n{self.text()}")
            time.sleep(0.05)

    def text(self):
        with open(self.log) as file:
            return file.read()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGTERM)
        code = self.process.wait(timeout=20)
        assert code == 0, f"exit code {code}:\n{self.text()}"
        assert not os.path.exists(self.socket)


def operate(build, out, name, driver, robot, orders):
    """What robot_client prints while a person types `orders`, each once the answer before it has come."""
    run = os.path.join(out, name)
    shutil.rmtree(run, ignore_errors=True)
    # A machine that is busy makes states late: that guard is another test's.
    client = subprocess.Popen(
        [f"{build}/bin/robot_client", "--arm", f"bridge:unix:{driver.socket}", "--robot", robot, "--set",
         "realtime.priority=0", "--set", "realtime.lock_memory=false", "--without", "arm_hold_s", "--set",
         "control.watchdogs.arm_hold_s=3", "--without", "arm_fault_s", "--set", "control.watchdogs.arm_fault_s=5",
         "--without", "delay_hold_s", "--set", "control.watchdogs.delay_hold_s=5", "--out", run],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, bufsize=1)
    text = ""
    os.set_blocking(client.stdout.fileno(), False)

    def read_until(words, seconds=30):
        nonlocal text
        end, begun = time.monotonic() + seconds, len(text)
        while words not in text[begun:]:
            if time.monotonic() > end:
                client.kill()
                raise SystemExit(f"{name}: no '{words}' in\n{text}\n{driver.text()}")
            try:
                came = os.read(client.stdout.fileno(), 1 << 16)
            except BlockingIOError:
                time.sleep(0.02)
                continue
            # An end of the pipe, not of the process: its last words may still be in it.
            if not came:
                raise SystemExit(f"{name} ended with {client.wait()} without '{words}' in\n{text}\n{driver.text()}")
            text += came.decode()

    read_until("control thread")
    time.sleep(1)  # an arm whose power was switched off and on gives way, and comes back
    for order, answer in orders:
        client.stdin.write(order + "\n")
        client.stdin.flush()
        read_until(answer)
    client.stdin.close()
    code = client.wait(timeout=30)
    assert code == 0 and os.path.exists(run + "/DONE"), f"exit code {code}\n{text}"
    if any(order == "stop" for order, _ in orders):
        assert "stop: the driver has none, so it holds where the arm stands" in text, text
    return text


ORDERS = [("enable", "the arm has power and holds"), ("jog J2 5deg", "the arm is there"),
          ("jog gripper 5mm", "the arm is there"), ("home", "the arm is home"),
          ("stop", "FAULT (quick_stop)"), ("clear", "no fault any more"), ("enable", "the arm has power and holds")]


def last_row(out, name):
    with open(os.path.join(out, name, "ticks.csv")) as file:
        head, *rows = file.read().splitlines()
    return dict(zip(head.split(","), rows[-1].split(",")))


def expect_home(out, name, within):
    row = last_row(out, name)
    for axis, home in (("q_J1", 0.3), ("q_J2", -0.2), ("q_gripper", 0.05)):
        assert abs(float(row[axis]) - home) < within, f"{name}: {axis} is {row[axis]}, home {home}"


def write(path, text):
    with open(path, "w") as file:
        file.write(text)
    return path


def ros2(build, out):
    two = write(f"{out}/two.yaml", TWO.replace("UNIT", "radians").replace("JAW", "unit: metres"))
    joints = json.dumps({"a": 0.1, "b": 0.2, "c": 9.0, "jaw": 0.03})
    environment = {"PYTHONPATH": f"{HERE}/ros_stand_in", "STAND_IN_JOINTS": joints, "STAND_IN_ORDER": "jaw,a,b"}
    for name, options in (("trajectory", ["--joints", "a,b,jaw"]),
                          ("forward", ["--joints", "jaw,a,b", "--forward", "--velocities"])):
        command = [sys.executable, f"{DEPLOY}/robostress_bridge_ros2.py", "--command-topic", "/arm/command", *options]
        with Driver(out, name, command, environment) as driver:
            text = operate(build, out, name, driver, two, [*ORDERS, ("quit", "")])
        assert ("no velocities" in text) == (name == "trajectory"), text
        assert "WARNING: the driver cannot take the power off" in text, text
        expect_home(out, name, 0.01)
    never = {**environment, "STAND_IN_JOINTS": '{"a": 0.0}'}
    with Driver(out, "missing", command, never) as driver:
        done = subprocess.run([f"{build}/bin/robot_client", "--arm", f"bridge:unix:{driver.socket}", "--robot", two,
                               "--out", f"{out}/none"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and "no state of the arm" in done.stdout + done.stderr, done
    assert "no JointState with" in driver.text(), driver.text()


def make_venv(venv):
    """What is missing to run LeRobot's robots, or None."""
    done = os.path.join(venv, "DONE")
    if os.path.exists(done):
        return None
    pip = [f"{venv}/bin/python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--timeout", "15",
           "--retries", "1"]
    for command in ([sys.executable, "-m", "venv", "--clear", venv],
                    [*pip, "-r", f"{HERE}/lerobot_requirements.txt"], [*pip, "--no-deps", LEROBOT]):
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode != 0:
            return f"{' '.join(command)} failed: {result.stdout}{result.stderr}"
    write(done, "installed\n")
    return None


def lerobot(build, out, venv):
    missing = make_venv(venv)
    if missing:
        print("skipped: " + missing)
        sys.exit(77)
    light = [f"{venv}/bin/python", f"{HERE}/lerobot_light.py", f"{DEPLOY}/robostress_bridge_lerobot.py"]

    bus, calibration = f"/tmp/servos-{os.getpid()}", f"{out}/calibration"
    os.makedirs(calibration, exist_ok=True)
    servos = subprocess.Popen([sys.executable, f"{HERE}/feetech_arm.py", bus, f"{calibration}/one.json"])
    try:
        while not os.path.exists(bus):
            time.sleep(0.02)
        command = [*light, "--robot.type=so101_follower", f"--robot.port={bus}", "--robot.id=one",
                   f"--robot.calibration_dir={calibration}"]
        with Driver(out, "so101", command) as driver:
            five = f"{HERE}/five_servos.yaml"
            text = operate(build, out, "so101", driver, five,
                           [*ORDERS, ("jog J6 5deg", "refused: this arm has 5 joints and a gripper"),
                            ("quit limp", "the joints have no power")])
        assert "the power goes off and the arm FALLS" in text, text
        row = last_row(out, "so101")
        for axis, home in (("q_J1", 0), ("q_J2", -0.4), ("q_J3", 0.5), ("q_J4", 0.2), ("q_gripper", 0.04)):
            assert abs(float(row[axis]) - home) < 0.02, f"{axis} is {row[axis]}, home {home}"
        with Driver(out, "again", command) as driver:
            operate(build, out, "before", driver, five, [("enable", "the arm has power and holds"),
                                                         ("home", "the arm is home"), ("quit", "")])
            for where in (driver.socket, "/tmp/none"):
                second = subprocess.run([*command, "--socket", where], capture_output=True, text=True, timeout=60,
                                        stdin=subprocess.DEVNULL)
                assert second.returncode == 1 and "end it" in second.stderr, second
            operate(build, out, "after", driver, five, [("quit", "")])
            row = last_row(out, "after")
            assert abs(float(row["q_J2"]) + 0.4) < 0.02, f"a second driver let the arm fall to {row['q_J2']}"
        with Driver(out, "percent", [*command, "--robot.use_degrees=false"]) as driver:
            done = subprocess.run([f"{build}/bin/robot_client", "--arm", f"bridge:unix:{driver.socket}", "--robot", five,
                                   "--out", f"{out}/none"], capture_output=True, text=True, timeout=60)
        assert done.returncode == 2 and "counts shoulder_pan from -100 to 100" in done.stdout + done.stderr, done
        uncalibrated = subprocess.run([*command, "--socket", "/tmp/none", "--robot.id=another"], capture_output=True,
                                      text=True, timeout=60, stdin=subprocess.DEVNULL)
        assert "run lerobot-calibrate" in uncalibrated.stderr, uncalibrated
    finally:
        servos.kill()
        servos.wait()
        os.unlink(bus)

    two = write(f"{out}/two_degrees.yaml", TWO.replace("UNIT", "degrees").replace(
        "JAW", "unit: range, driver_range: [0, 100], range: [0, 0.08]"))
    log = f"{out}/own.jsonl"
    shutil.rmtree(log, ignore_errors=True)
    command = [*light, "--robot-class", "own_robot:OwnRobot", f"--robot.log={log}", "--velocities"]
    environment = {"PYTHONPATH": HERE}
    kept = subprocess.run([*command, "--keep", "nothing", "--socket", "/tmp/none"], capture_output=True, text=True,
                          timeout=60, env={**os.environ, **environment})
    assert "this robot has ['a', 'lift', 'b', 'jaw']" in kept.stderr, kept
    with Driver(out, "own", [*command, "--keep", "lift"], environment) as driver:
        text = operate(build, out, "own", driver, two, [*ORDERS, ("quit", "")])
    assert "no velocities" not in text and "what the arm does when this driver ends is not known" in text, text
    expect_home(out, "own", 0.01)
    with open(log) as file:
        targets = [json.loads(line) for line in file]
    assert all(target["lift"] == 55.0 for target in targets), "the axis that nobody drives"


def main():
    what, build, out = sys.argv[1], os.path.abspath(sys.argv[2]), os.path.abspath(sys.argv[3])
    os.makedirs(out, exist_ok=True)
    if what == "ros2":
        ros2(build, out)
    else:
        lerobot(build, out, os.path.abspath(sys.argv[4]))
    print(what + ": all as it should be")


if __name__ == "__main__":
    main()
