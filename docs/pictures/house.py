#!/usr/bin/env python3
"""Draws the pictures of docs/architecture.md: docs/pictures/house.py [FOLDER] writes house.svg and processes.svg
into FOLDER, else beside itself. Plain SVG; colours follow the reader's choice of light or dark."""

import html
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
STYLE = """<style>
text { font-family: system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; fill: #1f2937; }
.page { fill: #ffffff; } .room { fill: #f3f4f6; stroke: #6b7280; } .torch { fill: #fde7c7; stroke: #b45309; }
.chip { fill: #ffffff; stroke: #9ca3af; } .quiet { fill: #4b5563; } .wire { stroke: #1d4ed8; } .wiretext { fill: #1d4ed8; }
.arrow { stroke: #4b5563; fill: none; } .head { fill: #4b5563; } .wirehead { fill: #1d4ed8; } .outside { fill: none; stroke: #6b7280; }
@media (prefers-color-scheme: dark) {
  text { fill: #e5e7eb; } .page { fill: #0d1117; } .room { fill: #1f2733; stroke: #8b949e; } .torch { fill: #4a3310; stroke: #f0b35a; }
  .chip { fill: #0d1117; stroke: #6e7681; } .quiet { fill: #b1bac4; } .wire { stroke: #79b8ff; } .wiretext { fill: #79b8ff; }
  .arrow { stroke: #b1bac4; } .head { fill: #b1bac4; } .wirehead { fill: #79b8ff; } .outside { stroke: #8b949e; }
}
</style>
<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto-start-reverse">
<path class="head" d="M0 0 L10 5 L0 10 z"/></marker>
<marker id="wirehead" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" orient="auto-start-reverse">
<path class="wirehead" d="M0 0 L10 5 L0 10 z"/></marker></defs>"""


class Picture:
    def __init__(self, width, height, label):
        self.parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
                      f'height="{height}" role="img" aria-label="{html.escape(label)}">', STYLE,
                      f'<rect class="page" width="{width}" height="{height}"/>']

    def text(self, x, y, words, size=13, kind="", weight="normal", anchor="start"):
        self.parts.append(f'<text class="{kind}" x="{x}" y="{y}" font-size="{size}" font-weight="{weight}" '
                          f'text-anchor="{anchor}">{html.escape(words)}</text>')

    def box(self, x, y, width, height, kind="room", dashed=False):
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self.parts.append(f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}" rx="6"{dash}/>')

    def room(self, x, y, width, height, title, says, chips=(), kind="room"):
        """A room of the house: its folder, what it is for, the folders within."""
        self.box(x, y, width, height, kind)
        self.text(x + 10, y + 21, title, 15, weight="bold")
        for number, line in enumerate(says):
            self.text(x + 10, y + 39 + 16 * number, line, 12, "quiet")
        left, top = x + 10, y + 30 + 16 * len(says)
        for chip in chips:
            size = 12 + 7.0 * len(chip)
            if left + size > x + width - 6:
                left, top = x + 10, top + 25
            self.parts.append(f'<rect class="chip" x="{left}" y="{top}" width="{size}" height="20" rx="4"/>')
            self.text(left + size / 2, top + 14, chip, 12, anchor="middle")
            left += size + 6

    def arrow(self, *points, wire=False, both=False):
        path = "M" + " L".join(f"{x} {y}" for x, y in points)
        kind, head = ("wire", "wirehead") if wire else ("arrow", "head")
        start = f' marker-start="url(#{head})"' if both else ""
        self.parts.append(f'<path class="{kind}" d="{path}" fill="none" stroke-width="{2.5 if wire else 1.4}" '
                          f'marker-end="url(#{head})"{start}/>')

    def write(self, name):
        with open(os.path.join(sys.argv[1] if len(sys.argv) > 1 else HERE, name), "w", encoding="utf-8") as file:
            file.write("\n".join(self.parts) + "\n</svg>\n")


# Who stands on whom: tests/docs/house_test.py holds it against the includes. LORA and CORE: adapter's halves.
STANDS_ON = [
    ("server", "common/wire", ((110, 274), (110, 580))),
    ("server", "LORA", ((270, 274), (270, 580))),
    ("server", "common/rpc", ((350, 274), (350, 553), (700, 553), (700, 580))),
    ("eval", "common/unit", ((398, 144), (398, 498), (420, 498))),
    ("eval", "calibration", ((660, 144), (660, 170))),
    ("calibration", "sim_worker", ((530, 274), (530, 300))),
    ("calibration", "robot_client", ((780, 274), (780, 300))),
    ("sim_worker", "common/unit", ((500, 428), (500, 470))),
    ("sim_worker", "common/rpc", ((630, 428), (630, 458), (740, 458), (740, 580))),
    ("robot_client", "common/unit", ((690, 428), (690, 444), (590, 444), (590, 470))),
    ("robot_client", "common/rpc", ((830, 428), (830, 580))),
    ("eval", "common/wire", ((386, 144), (386, 536), (140, 536), (140, 580))),
    ("sim_worker", "common/wire", ((440, 428), (440, 450), (392, 450), (392, 544), (158, 544), (158, 580))),
    ("common/unit", "CORE", ((525, 526), (525, 580))),
    ("python", "CORE", ((190, 526), (190, 562), (450, 562), (450, 580))),
    ("LORA", "CORE", ((380, 608), (420, 608))),
    ("common/wire", "common", ((110, 636), (110, 670))),
    ("CORE", "common", ((525, 636), (525, 670))),
    ("common/rpc", "common", ((700, 636), (700, 710), (645, 710))),
    ("common/rpc", "proto", ((800, 636), (800, 770))),
]
LIBTORCH = ("policy", "serve", "train")  # the programs that link it


def house():
    p = Picture(940, 850, "The floors of the source: each room stands on those below it")
    for floor, y in enumerate((796, 708, 614, 502, 360, 226, 110, 34)):
        p.text(16, y, str(floor), 15, "quiet", "bold")
    p.room(40, 12, 860, 34, "tests/", ())
    p.text(104, 33, "mirrors every room and may use what is public in any of them", 12, "quiet")
    p.room(40, 66, 860, 78, "eval/", ("plans a sweep, starts the other programs, counts, reports",),
           ("plan", "store", "statistics", "report", "launch", "paper", "piper_study", "close_loop"))
    p.room(40, 170, 330, 104, "server/", ("policies that learn while they serve",),
           ("policies", "training", "sessions", "inference", "wire", "operations", "pages", "proxy"), "torch")
    p.room(420, 170, 480, 104, "calibration/", ("what the model of a robot lacks; MuJoCo",),
           ("data", "model", "search", "report", "fidelity"))
    p.room(420, 300, 225, 128, "sim_worker/", ("the simulated Panda; MuJoCo",),
           ("suites", "libero", "record", "environment", "worker"))
    p.room(665, 300, 235, 128, "robot_client/", ("a Piper; MuJoCo in its emulator",),
           ("control", "can", "piper", "teach", "cameras", "motion", "study", "emulator", "demonstration"))
    p.room(420, 470, 225, 56, "common/unit/", ("a unit of a sweep, any robot's",))
    p.room(125, 470, 136, 56, "python/", ("library and wheel",))
    p.room(40, 580, 140, 56, "common/wire/", ("openpi's WebSocket",))
    p.room(200, 580, 180, 56, "adapter/: LoRA", ("loss, Adam, updates",), (), "torch")
    p.room(420, 580, 225, 56, "adapter/: core", ("residuals, corrections, methods",))
    p.room(665, 580, 235, 56, "common/rpc/", ("gRPC to and from our own types",))
    p.room(40, 670, 605, 80, "common/", ("types, files, statistics, and what every robot shares",),
           ("joint_errors", "rollout", "records"))
    p.room(665, 770, 235, 56, "proto/", ("the schema, robostress.v1",))
    for _, _, points in STANDS_ON:
        p.arrow(*points)
    p.box(40, 780, 16, 16, "torch")
    p.text(64, 793, "needs LibTorch: the programs " + ", ".join(LIBTORCH) + ". No other links it.", 13)
    p.arrow((40, 818), (60, 818))
    p.text(68, 823, "includes and links: never up, never sideways. Longer ways down are left out.", 13)
    p.write("house.svg")


def processes():
    p = Picture(940, 670, "The programs that run, and the wires between them")

    def program(x, y, width, height, title, says, kind="room"):
        p.room(x, y, width, height, title, says, (), kind)

    program(30, 30, 230, 62, "robostress sweep", ("plans units, starts the rest, reports",))
    program(30, 186, 230, 78, "robostress worker", ("one unit: simulator, episodes", "one process for each unit"))
    program(30, 356, 230, 78, "a run directory", ("units/ID/ ... DONE, episodes.csv,", "report.html, table.csv"), "outside")
    program(370, 186, 230, 96, "robostress serve", ("one session for each robot", "predictions from a queue,",
                                                     "adapters learn beside them"), "torch")
    program(370, 376, 230, 58, "a state directory", ("sessions, journals, snapshots",), "outside")
    program(690, 186, 220, 78, "robot_client", ("30 times a second: limits,", "watchdogs, states"))
    program(690, 356, 220, 78, "a Piper", ("or piper_emulator: the same", "frames, no arm"), "outside")
    program(690, 30, 220, 62, "openpi's clients", ("unchanged",), "outside")
    program(370, 30, 230, 62, "operators", ("browser, Prometheus, sessions",), "outside")
    program(370, 476, 230, 58, "robostress calibrate", ("logs in, scenario out",))
    program(30, 582, 230, 62, "another's policy server", ("openpi's wire, or vla-eval's",), "outside")
    program(370, 582, 230, 62, "robostress proxy", ("corrects what passes, in limits",))
    program(690, 582, 220, 62, "a robot's own client", ("unchanged",), "outside")

    p.arrow((145, 92), (145, 186))
    p.text(152, 150, "starts", 12, "quiet")
    p.arrow((260, 72), (330, 72), (330, 205), (370, 205))
    p.text(282, 66, "starts", 12, "quiet")
    p.arrow((145, 264), (145, 356))
    p.text(152, 316, "writes", 12, "quiet")
    p.arrow((30, 395), (18, 395), (18, 76), (30, 76))
    p.text(23, 140, "reads", 12, "quiet")
    p.arrow((260, 240), (370, 240), wire=True, both=True)
    p.text(315, 232, "gRPC", 13, "wiretext", "bold", "middle")
    p.text(315, 258, "Predict,", 12, "wiretext", anchor="middle")
    p.text(315, 273, "Feedback", 12, "wiretext", anchor="middle")
    p.arrow((690, 240), (600, 240), wire=True, both=True)
    p.text(645, 232, "gRPC", 13, "wiretext", "bold", "middle")
    p.text(645, 258, "Predict,", 12, "wiretext", anchor="middle")
    p.text(645, 273, "Feedback", 12, "wiretext", anchor="middle")
    p.arrow((690, 72), (645, 72), (645, 205), (600, 205), wire=True, both=True)
    p.text(652, 130, "WebSocket", 13, "wiretext", "bold")
    p.arrow((485, 92), (485, 186), wire=True, both=True)
    p.text(492, 130, "HTTP, gRPC", 13, "wiretext", "bold")
    p.text(492, 146, "for operators", 12, "wiretext")
    p.arrow((800, 264), (800, 356), wire=True, both=True)
    p.text(808, 316, "CAN", 13, "wiretext", "bold")
    p.arrow((485, 282), (485, 376), both=True)
    p.text(492, 335, "writes, recovers", 12, "quiet")
    p.arrow((145, 434), (145, 505), (370, 505))
    p.text(152, 498, "joint logs", 12, "quiet")
    p.arrow((910, 225), (926, 225), (926, 520), (600, 520))
    p.text(690, 513, "a run's logs", 12, "quiet")
    p.arrow((370, 526), (8, 526), (8, 46), (30, 46))
    p.text(10, 545, "scenario.yaml, for a sweep or the emulator", 12, "quiet")
    p.arrow((260, 254), (276, 254), (276, 562), (200, 562), (200, 582), wire=True, both=True)
    p.text(284, 400, "WebSocket", 13, "wiretext", "bold")
    p.text(284, 416, "--policy-url", 12, "wiretext")
    p.arrow((370, 624), (260, 624), wire=True, both=True)
    p.text(315, 610, "WebSocket", 13, "wiretext", "bold", "middle")
    p.arrow((690, 624), (600, 624), wire=True, both=True)
    p.text(645, 610, "WebSocket", 13, "wiretext", "bold", "middle")
    p.arrow((485, 582), (485, 534))
    p.text(492, 563, "joint logs", 12, "quiet")
    p.write("processes.svg")


if __name__ == "__main__":
    house()
    processes()
