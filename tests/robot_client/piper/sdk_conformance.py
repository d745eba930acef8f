"""The vendor's piper_sdk, unmodified, against piper_emulator: prints a table, exits with the number
of failed rows. Run by sdk_conformance.sh, which makes the network namespace."""
import contextlib
import io
import math
import os
import signal
import socket
import subprocess
import sys
import time

import can

GROUP, PORT = "239.74.163.2", 43113
MILLI_DEGREES = 180000 / math.pi
rows = []


def check(name, passed, detail=""):
    rows.append((name, bool(passed)))
    print(f"{'ok  ' if passed else 'FAIL'} {name:58s} {detail}", flush=True)


def quiet(call, *arguments):
    """The SDK prints; its words do not belong in the table."""
    with contextlib.redirect_stdout(io.StringIO()):
        return call(*arguments)


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return False


def start_emulator(program, *arguments):
    process = subprocess.Popen([program, "--bus", f"udp:{GROUP}:{PORT}", *arguments], stdout=subprocess.PIPE,
                               text=True)
    process.stdout.readline()
    return process


def connect(name):
    from piper_sdk import C_PiperInterface_V2
    arm = C_PiperInterface_V2(can_name=name, judge_flag=False, can_auto_init=False)
    arm.CreateCanBus(can_name=GROUP, bustype="udp_multicast", expected_bitrate=1000000, judge_flag=False)
    arm.ConnectPort()
    arm.EnableFkCal()
    return arm


def joints(arm):
    state = arm.GetArmJointMsgs().joint_state
    return [getattr(state, f"joint_{i}") for i in range(1, 7)]


def status(arm):
    return arm.GetArmStatus().arm_status


def enable(arm, seconds=5):
    """As the SDK's demos: ask until the arm says so. Returns the number of questions, or 0."""
    end, asked = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        asked += 1
        if quiet(arm.EnablePiper):
            return asked
        time.sleep(0.02)
    return 0


def stream(arm, target, seconds, gripper=None):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        arm.MotionCtrl_2(0x01, 0x01, 100, 0x00)
        arm.JointCtrl(*target)
        if gripper is not None:
            arm.GripperCtrl(gripper, 1000, 0x01, 0)
        time.sleep(0.02)


def check_states(arm):
    check("firmware version", wait_for(lambda: arm.GetPiperFirmwareVersion() == "S-V1.8-9", 2),
          str(arm.GetPiperFirmwareVersion()))
    # Limits at the resolution of the answer, 0.1 degrees.
    limits = arm.GetAllMotorAngleLimitMaxSpd().all_motor_angle_limit_max_spd.motor[1:]
    check("0x473 answers of six joints", [m.max_angle_limit for m in limits] ==
          [1500, 1799, 0, 1000, 699, 1200] and all(m.max_joint_spd == 300 for m in limits),
          f"speed {limits[0].max_joint_spd} x 0.01 rad/s")
    accelerations = arm.GetAllMotorMaxAccLimit().all_motor_max_acc_limit.motor[1:]
    check("0x47C answers of six joints", all(m.max_joint_acc == 500 for m in accelerations))
    check("disabled at power-on", not any(arm.GetArmEnableStatus()))


def check_rates(program):
    """Counted on the wire by python-can alone: the SDK's own figures depend on its threads."""
    bus = can.Bus(channel=GROUP, interface="udp_multicast", port=PORT)
    counts, end = {}, time.monotonic() + 3
    while time.monotonic() < end:
        message = bus.recv(0.1)
        if message is not None:
            counts[message.arbitration_id] = counts.get(message.arbitration_id, 0) + 1
    bus.shutdown()
    fast = [*range(0x251, 0x257), *range(0x2A1, 0x2A9)]
    slow = [*range(0x261, 0x267)]
    rate = {i: counts.get(i, 0) / 3 for i in fast + slow}
    total = sum(rate.values())
    check("14 identifiers at 200 per second, within 5 %", all(abs(rate[i] - 200) <= 10 for i in fast),
          f"{min(rate[i] for i in fast):.1f} to {max(rate[i] for i in fast):.1f}")
    check("6 identifiers at 40 per second, within 5 %", all(abs(rate[i] - 40) <= 2 for i in slow),
          f"{min(rate[i] for i in slow):.1f} to {max(rate[i] for i in slow):.1f}")
    check("3,040 frames per second, within 5 %", abs(total - 3040) <= 152, f"{total:.0f}")


def check_motion(arm):
    asked = enable(arm)
    check("EnablePiper converges", asked > 0, f"{asked} calls")
    check("enable bits of six drivers", all(arm.GetArmEnableStatus()))
    target = [20000, 80000, -60000, 10000, -10000, 15000]
    stream(arm, target, 0.3)
    check("motion status 1 while moving", int(status(arm).motion_status) == 1)
    stream(arm, target, 2.5, gripper=50000)
    time.sleep(0.3)
    worst = max(abs(a - b) for a, b in zip(joints(arm), target))
    check("JointCtrl moves the joints to 0.2 degrees", worst <= 200, f"worst {worst} x 0.001 degrees")
    check("motion status 0 when reached", int(status(arm).motion_status) == 0)
    check("control mode CAN, move mode J", int(status(arm).ctrl_mode) == 1 and int(status(arm).mode_feed) == 1)
    opening = arm.GetArmGripperMsgs().gripper_state.grippers_angle
    check("GripperCtrl opens to 50 mm within 1 mm", abs(opening - 50000) <= 1000, f"{opening} um")
    pose = arm.GetArmEndPoseMsgs().end_pose
    fk = arm.GetFK("feedback")[-1]
    distance = math.dist([pose.X_axis / 1e3, pose.Y_axis / 1e3, pose.Z_axis / 1e3], fk[:3])
    angle = max(abs((a / 1e3 - b + 180) % 360 - 180)
                for a, b in zip([pose.RX_axis, pose.RY_axis, pose.RZ_axis], fk[3:]))
    check("end pose equals the SDK's kinematics: 0.1 mm, 0.2 degrees", distance <= 0.1 and angle <= 0.2,
          f"{distance:.4f} mm, {angle:.4f} degrees")
    effort = arm.GetArmHighSpdInfoMsgs().motor_2.effort
    check("J2 carries the arm: effort from its current", 1000 <= abs(effort) <= 15000, f"{effort:.0f} mNm")


def check_limits(arm):
    before = joints(arm)
    stream(arm, [20000, 80000, -60000, 110000, -10000, 15000], 0.6)
    time.sleep(0.1)
    check("target beyond J4's limit: status 4 and J4's bit",
          int(status(arm).arm_status) == 4 and arm.GetArmStatus().arm_status.err_status.joint_4_angle_limit)
    worst = max(abs(a - b) for a, b in zip(joints(arm), before))
    check("and no joint follows", worst <= 200, f"worst {worst} x 0.001 degrees")
    stream(arm, before, 0.4)
    check("targets within the limits clear it", wait_for(lambda: int(status(arm).arm_status) == 0, 1))


def check_stop(arm):
    z_before = arm.GetArmEndPoseMsgs().end_pose.Z_axis
    arm.EmergencyStop(0x01)
    check("quick stop: status 1", wait_for(lambda: int(status(arm).arm_status) == 1, 1))
    time.sleep(0.5)
    z_half = arm.GetArmEndPoseMsgs().end_pose.Z_axis
    check("and the arm sinks slowly", 1000 < z_before - z_half < 150000, f"{(z_before - z_half) / 1e3:.0f} mm in 0.5 s")
    quiet(arm.EnablePiper)
    time.sleep(0.2)
    check("enabling does not end it", int(status(arm).arm_status) == 1)
    arm.EmergencyStop(0x02)
    check("reset: power off, status 0", wait_for(
        lambda: int(status(arm).arm_status) == 0 and not any(arm.GetArmEnableStatus()), 1))
    arm.EnableArm(7)
    time.sleep(0.3)
    once = all(arm.GetArmEnableStatus())
    asked = enable(arm)
    check("after a reset one enable is not enough, two are", not once and asked > 0)


def check_junk(arm):
    """What is no CAN frame must not disturb the emulator; the SDK survives it as well."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    import msgpack
    extended = {"timestamp": 0.0, "arbitration_id": 0x150, "is_extended_id": True, "is_remote_frame": False,
                "is_error_frame": False, "channel": None, "dlc": 8, "data": bytes([1] + [0] * 7), "is_fd": False,
                "bitrate_switch": False, "error_state_indicator": False}
    for datagram in [b"", b"junk", b"\x8b" * 60, b"\xff" * 3000, msgpack.packb(extended, use_bin_type=True)]:
        sender.sendto(datagram, (GROUP, PORT))
    sender.close()
    time.sleep(0.3)
    check("junk, oversize and extended frames change nothing",
          int(status(arm).arm_status) == 0 and all(arm.GetArmEnableStatus()))


def check_death(arm, emulator):
    emulator.send_signal(signal.SIGTERM)
    print("     " + emulator.stdout.read().strip())
    emulator.wait(5)
    began = time.monotonic()
    check("isOk() is false within 0.6 s of the emulator's end", wait_for(lambda: not arm.isOk(), 1.5) and
          time.monotonic() - began <= 0.6, f"{time.monotonic() - began:.2f} s")


def check_fault(arm):
    check("isOk() when an arm is there again", wait_for(arm.isOk, 2))
    enable(arm)
    check("collision fault: status 7", wait_for(lambda: int(status(arm).arm_status) == 7, 15))
    check("and the driver's collision bit of J2", wait_for(
        lambda: arm.GetArmLowSpdInfoMsgs().motor_2.foc_status.collision_status, 1))


def main():
    program = sys.argv[1]
    emulator = start_emulator(program)
    try:
        check_rates(program)
        arm = quiet(connect, "conformance")
        check("isOk()", wait_for(arm.isOk, 3))
        check_states(arm)
        check_motion(arm)
        check_limits(arm)
        check_stop(arm)
        check_junk(arm)
        check_death(arm, emulator)
        emulator = start_emulator(program, "--fault", "collision:J2@4")
        check_fault(arm)
    finally:
        emulator.kill()
    failed = sum(not passed for _, passed in rows)
    print(f"{len(rows) - failed} of {len(rows)} rows hold")
    sys.stdout.flush()
    os._exit(1 if failed else 0)  # the SDK's reader thread never ends by itself


main()
