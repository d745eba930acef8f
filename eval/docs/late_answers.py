#!/usr/bin/env python3
"""The study of docs/results/late-answers.md: runs its sweeps and prints its tables.

    python3 eval/docs/late_answers.py --robostress build/release/bin/robostress --out runs/late

In rounds of one initial state a task; a sweep a latency, mode and round. What is there already is
not run again; the table is of the rounds that are there in every cell. --table prints only.
"""

import argparse
import json
import math
import pathlib
import random
import subprocess

SCENARIOS = {"clean": "Clean", "heavy_payload": "Heavy Payload",
             "aged_joint_uniform": "Aged Joint-Uniform"}
MODES = ["waiting", "switch", "crossfade", "rtc"]
LATENCIES = [50, 150, 300]
CELLS = [(0, "")] + [(ms, mode) for ms in LATENCIES for mode in MODES]


STATES = 1  # initial states of a task in a round


def run(options, ms, mode, first):
    """One sweep: nano, the three scenarios at L5, initial state `first` of every task."""
    command = [options.robostress, "sweep", "--suites", "tabletop_goal", "--scenarios",
               ",".join(SCENARIOS), "--policies", "nano", "--methods", options.method,
               "--episodes", str(STATES), "--first-initial-state", str(first),
               "--set", "latency.smoothness=true", "--workers", str(options.workers), "--quiet",
               "--no-report", "--out", str(folder(options, ms, mode, first))]
    if options.server:
        command += ["--server", options.server]
    if ms:
        command += ["--latency-ms", str(ms), "--late", mode]
    if mode == "rtc":
        command += ["--set", f"latency.guide_rows={options.guide_rows}"]
    subprocess.run(command, check=True)


def folder(options, ms, mode, first):
    return pathlib.Path(options.out) / f"{options.method}-{ms}-{mode or 'now'}-{first}"


def rows(options, ms, mode, firsts):
    """Episodes by (scenario, task, initial state)."""
    found = {}
    for first in firsts:
        for done in sorted(folder(options, ms, mode, first).glob("units/*/DONE")):
            for line in (done.parent / "episodes.jsonl").read_text().splitlines():
                row = json.loads(line)
                found[row["scenario"], row["task"], row["initial_state"]] = row
    return found


def whole_rounds(options):
    """First states of the rounds whose units are done in every cell."""
    return [first for first in options.rounds
            if all(len(list(folder(options, ms, mode, first).glob("units/*/DONE"))) == len(SCENARIOS)
                   for ms, mode in options.cells)]


def wilson(successes, n, z=1.959964):
    p, q = successes / n, z * z / n
    middle, half = (p + q / 2) / (1 + q), z * math.sqrt(p * (1 - p) / n + q / (4 * n)) / (1 + q)
    return 100 * (middle - half), 100 * (middle + half)


def paired(a, b, draws=4000):
    """Difference of success a - b in points, its 95 % interval (bootstrap over task and initial
    state, which the scenarios share), and a two-sided sign test of the pairs that differ."""
    clusters = {}
    for key in a.keys() & b.keys():
        clusters.setdefault(key[1:], []).append(a[key]["success"] - b[key]["success"])
    groups = [clusters[key] for key in sorted(clusters)]
    pairs = sum(map(len, groups))
    generator = random.Random(5)
    means = sorted(sum(sum(g) for g in generator.choices(groups, k=len(groups))) / pairs
                   for _ in range(draws))
    won = sum(d > 0 for g in groups for d in g)
    lost = sum(d < 0 for g in groups for d in g)
    differ = won + lost
    tail = sum(math.comb(differ, k) for k in range(min(won, lost) + 1)) / 2 ** differ
    return {"difference": 100 * (won - lost) / pairs, "low": 100 * means[int(0.025 * draws)],
            "high": 100 * means[int(0.975 * draws)], "won": won, "lost": lost,
            "p": min(1.0, 2 * tail)}


def holm(values):
    order = sorted(range(len(values)), key=values.__getitem__)
    adjusted, least = [0.0] * len(values), 0.0
    for rank, index in enumerate(order):
        least = max(least, min(1.0, (len(values) - rank) * values[index]))
        adjusted[index] = least
    return adjusted


def mean(episodes, key):
    return sum(row[key] for row in episodes) / len(episodes)


def table(options):
    firsts = whole_rounds(options)
    if not firsts:
        return print("no round is there in every cell yet")
    data = {cell: rows(options, *cell, firsts) for cell in options.cells}
    print("| latency | mode | " + " | ".join(SCENARIOS.values()) + " | all | jerk | jump | steps |")
    print("|---:|---|" + "---:|" * (len(SCENARIOS) + 4))
    for (ms, mode), found in data.items():
        cells = []
        for scenario in [*SCENARIOS, None]:
            of = [row for key, row in found.items() if scenario in (None, key[0])]
            won = sum(row["success"] for row in of)
            low, high = wilson(won, len(of))
            cells.append(f"{100 * won / len(of):.1f} [{low:.0f}, {high:.0f}]")
        of = list(found.values())
        print(f"| {ms} | {mode or '-'} | " + " | ".join(cells) + f" | {mean(of, 'jerk'):.1f} | "
              f"{mean(of, 'jump'):.3f} | {mean(of, 'steps'):.0f} |")
    print("\nepisodes a cell:", sorted({len(found) for found in data.values()}), "\n")
    pairs = [(ms, a, b) for ms in LATENCIES
             for a, b in [("switch", "waiting"), ("crossfade", "waiting"), ("rtc", "waiting"),
                          ("rtc", "crossfade")] if (ms, a) in data and (ms, b) in data]
    results = [paired(data[ms, a], data[ms, b]) for ms, a, b in pairs]
    adjusted = holm([result["p"] for result in results])
    print("| latency | difference | points | won/lost | p (Holm) |\n|---:|---|---:|---:|---:|")
    for (ms, a, b), r, p in zip(pairs, results, adjusted):
        print(f"| {ms} | {a} - {b} | {r['difference']:+.1f} [{r['low']:+.1f}, {r['high']:+.1f}] | "
              f"+{r['won']}/-{r['lost']} | {p:.3g} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robostress", default="robostress")
    parser.add_argument("--out", default="runs/late")
    parser.add_argument("--rounds", default="0,1,2,3,4", help="initial states")
    parser.add_argument("--server", default="", help="HOST:PORT that holds nano already")
    parser.add_argument("--method", default="base")
    parser.add_argument("--guide-rows", type=int, default=0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--cells", default="", help="MS:MODE,...: only these")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    options.rounds = [int(first) for first in options.rounds.split(",")]
    options.cells = [(int(ms), mode) for ms, mode in (cell.split(":") for cell in
                                                      options.cells.split(",") if cell)] or CELLS
    if not options.table:
        for first in options.rounds:
            for ms, mode in options.cells:
                run(options, ms, mode, first)
    table(options)


if __name__ == "__main__":
    main()
