#!/usr/bin/env python3
"""The table of the paper's readings in docs/results/paper-form.md from kept outcomes: eval/docs/paper_form.py [READING...]

Reads paper-form/READING.jsonl beside this file, as eval/conditions/paper_readings.sh writes them. One session is carried
through the ten tasks of a suite, so clusters are the 20 tasks; scenarios lie within them. Pairs: equal scenario, task,
initial state and seed.
"""

import json
import pathlib
import sys
from collections import defaultdict

from winning_back import cell, holm, differences, rate, sign_flip_p

FOLDER = pathlib.Path(__file__).parent / "paper-form"
SCENARIOS = ["heavy_payload", "thermal_drift_stribeck", "aged_transmission", "aged_joint_uniform"]
CONTROLS = ["base", "null", "gain"]
LATER = ["nominal_intent-3e-5"]  # added when the others had been read: outside of Holm's family


def outcomes(reading):
    """As winning_back.outcomes."""
    table = defaultdict(lambda: defaultdict(dict))
    for line in (FOLDER / f"{reading}.jsonl").read_text().splitlines():
        unit = json.loads(line)
        for task, row in zip(unit["tasks"], unit["outcomes"]):
            for i, outcome in enumerate(row):
                table[unit["scenario"]][unit["suite"], task][unit["seed"], unit["first_initial_state"] + i] = int(outcome)
    return table


def main():
    names = sys.argv[1:] or sorted(file.stem for file in FOLDER.glob("*.jsonl"))
    tables = {name: outcomes(name) for name in names}
    print("success [%]\nreading", "clean", *SCENARIOS, "mean of four", "n a cell", sep=" | ")
    for name, table in tables.items():
        rates = [rate(table, c) for c in ["clean", *SCENARIOS]]
        mean = sum(r for r, _ in rates[1:]) / len(SCENARIOS)
        print(name, *(f"{r:.1f}" for r, _ in rates), f"{mean:.1f}", rates[0][1], sep=" | ")
    readings = [name for name in names if name not in CONTROLS + LATER]
    for control in [c for c in CONTROLS if c in tables]:
        print(f"\nagainst {control} on the same episodes [points, 95 %, p]; Holm over the readings in brackets")
        others = [name for name in readings + LATER + CONTROLS if name in tables and name != control]
        p_values = [sign_flip_p(differences(tables[name], tables[control], SCENARIOS)[0]) for name in readings]
        corrected = dict(zip(readings, holm(p_values)))
        for name in others:
            family = f" ({corrected[name]:.2g})" if name in corrected else ""
            print(name, cell(tables[name], tables[control], SCENARIOS) + family,
                  "clean " + cell(tables[name], tables[control], ["clean"]),
                  *(f"{c} {cell(tables[name], tables[control], [c])}" for c in SCENARIOS), sep=" | ")


if __name__ == "__main__":
    main()
