#!/usr/bin/env python3
"""Runs a program with LeRobot's robots and without LeRobot's learning half, which takes gigabytes.

    lerobot_light.py PROGRAM ARGUMENTS...

What robots import of torch and the processors are names in annotations: they are empty here. The
classes of robots, motors and buses are LeRobot's own, of the package that is installed; only the
deadline of a servo's answer is longer.
"""

import runpy
import sys
import types


class Nothing(types.ModuleType):
    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


for module in ("torch", "accelerate", "datasets", "datasets.utils", "datasets.utils.logging",
               "lerobot.processor"):
    sys.modules[module] = Nothing(module)


def patient(port, length):
    """The deadline of an answer [ms]: a busy machine lets emulated servos wait longer than 50."""
    port.packet_start_time, port.packet_timeout = port.getCurrentTime(), 2000


if __name__ == "__main__":
    import lerobot.motors.feetech.feetech as feetech

    feetech.patch_setPacketTimeout = patient
    sys.argv = sys.argv[1:]
    runpy.run_path(sys.argv[0], run_name="__main__")
