#!/usr/bin/env python3
"""The tables of docs/results/libero-tables.md from kept outcomes: eval/docs/libero_tables.py [FOLDER]
    eval/docs/libero_tables.py --residual RUN...     residual of each scenario, of the runs' episodes.csv

Reads FOLDER/METHOD/PART-FIRST.jsonl as eval/conditions/libero_tables.sh writes them; FOLDER: libero-tables beside this
file. Clusters are the 40 tasks; scenarios, levels and states lie within them. Pairs: equal condition, task, state and seed.
Losses are ranked beside the paper's base (tab:realistic) and ours on the embedded suites (winning-back/base).
"""

import csv
import json
import pathlib
import sys
from collections import defaultdict

from winning_back import FOLDER as EMBEDDED, SEVEN, cell, differences, holm, outcomes, rate, sign_flip_p

KEPT = pathlib.Path(__file__).parent / "libero-tables"
NOISE = ["isolated_stribeck", "isolated_backlash", "isolated_compliance", "isolated_gravity"]
LEVELS = range(1, 6)
PAPER = {"paper pi0.5": dict(zip(["clean", *SEVEN], [97.0, 44.1, 54.1, 83.4, 33.2, 29.5, 43.9, 55.6])),
         "paper pi0": dict(zip(["clean", *SEVEN], [91.1, 42.3, 46.1, 75.5, 26.8, 23.0, 34.5, 43.9]))}
PAPER_RESIDUAL = dict(zip(["clean", *SEVEN], [23.4, 48.6, 47.5, 46.1, 38.7, 48.2, 56.3, 47.0]))  # tab:residual-magnitude
# As declared before the runs: the primary comparison, and Holm's family of three.
PRIMARY = ("ours_replanning", "base")
SECONDARY = [("ours_replanning", "gain"), ("ours_replanning", "smooth_fewer_rows"), ("smooth_fewer_rows", "base")]
# Thought of after the result of smooth_fewer_rows.
EXPLORED = [("ours_replanning", "gain_two_rows"), ("gain_two_rows", "smooth_fewer_rows")]


def part_of(folder, method, part):
    """{condition: {(suite, task): {(seed, state): 0 or 1}}}; condition: (scenario, severity)."""
    table = defaultdict(lambda: defaultdict(dict))
    for file in sorted((folder / method).glob(f"{part}-*.jsonl")):
        for line in file.read_text().splitlines():
            unit = json.loads(line)
            for task, row in zip(unit["tasks"], unit["outcomes"]):
                for i, outcome in enumerate(row):
                    key = unit["seed"], unit["first_initial_state"] + i
                    table[unit["scenario"], unit["severity"]][unit["suite"], task][key] = int(outcome)
    return table


def ranks(values):
    """From 1, ties share their mean rank."""
    order = sorted(values)
    return [order.index(v) + (order.count(v) + 1) / 2 for v in values]


def spearman(one, other):
    a, b = ranks(one), ranks(other)
    mean = (len(a) + 1) / 2
    covariance = sum((x - mean) * (y - mean) for x, y in zip(a, b))
    return covariance / (sum((x - mean) ** 2 for x in a) * sum((y - mean) ** 2 for y in b)) ** 0.5


def losses(success):
    return [success["clean"] - success[scenario] for scenario in SEVEN]


def row(name, cells):
    print(name, *cells, sep=" | ")


def main_table(seven):
    print("Clean and the seven at L5: success [%]")
    row("scenario", [*seven, *PAPER])
    measured = {m: {c: rate(t, c)[0] for c in ["clean", *SEVEN]} for m, t in seven.items()}
    for condition in ["clean", *SEVEN]:
        row(condition, [f"{s[condition]:.1f}" for s in (*measured.values(), *PAPER.values())])
    row("mean of seven", [f"{sum(s[c] for c in SEVEN) / 7:.1f}" for s in (*measured.values(), *PAPER.values())])
    row("n a cell", [rate(t, "clean")[1] for t in seven.values()])
    for method, table in seven.items():
        print(f"\n{method}: successes in each suite")
        suites = sorted({suite for suite, _ in table["clean"]})
        row("scenario", suites)
        for condition in ["clean", *SEVEN]:
            values = {s: [v for (suite, _), pairs in table[condition].items() if suite == s for v in pairs.values()]
                      for s in suites}
            row(condition, [f"{sum(v)} of {len(v)}" for v in values.values()])
    embedded = outcomes("base", EMBEDDED)
    lost = {"LIBERO": losses(measured["base"]), **{name: losses(s) for name, s in PAPER.items()},
            "embedded suites": losses({c: rate(embedded, c)[0] for c in ["clean", *SEVEN]})}
    print("\nRank correlation of the seven losses of base")
    row("", lost)
    for name, values in lost.items():
        row(name, [f"{spearman(values, other):.2f}" for other in lost.values()])


def comparisons(seven):
    print("\nOn the same episodes, mean of the seven [points, 95 % and p by 40 tasks]; Clean")
    pairs = [p for p in [PRIMARY, *SECONDARY] if set(p) <= set(seven)]
    family = [p for p in pairs if p in SECONDARY]
    corrected = dict(zip(family, holm([sign_flip_p(differences(seven[a], seven[b], SEVEN)[0]) for a, b in family])))
    others = [(m, "base") for m in seven if m != "base" and (m, "base") not in pairs]
    others += [p for p in EXPLORED if set(p) <= set(seven)]
    for a, b in pairs + others:
        note = f"by Holm over {len(family)} {corrected[a, b]:.2g}" if (a, b) in corrected else ""
        row(f"{a} - {b}", [cell(seven[a], seven[b], SEVEN), note, f"clean {cell(seven[a], seven[b], ['clean'])}"])
    for a, b in pairs + others:
        p_values = holm([sign_flip_p(differences(seven[a], seven[b], [c])[0]) for c in SEVEN])
        print(f"\n{a} - {b}, each scenario; p by Holm over the seven")
        for scenario, p in zip(SEVEN, p_values):
            row(scenario, [cell(seven[a], seven[b], [scenario], False), f"p {p:.2g}"])


def other_tables(folder, methods):
    for part, title in (("noise", "Each error alone, L5: success [%]"), ("levels", "Severity: success [%], mean of the seven")):
        tables = {m: part_of(folder, m, part) for m in methods}
        tables = {m: t for m, t in tables.items() if t}
        if not tables:
            continue
        print(f"\n{title}")
        row("", tables)
        if part == "noise":
            for scenario in NOISE:
                row(scenario, [f"{rate(t, (scenario, 5))[0]:.1f}" for t in tables.values()])
            row("mean", [f"{sum(rate(t, (s, 5))[0] for s in NOISE) / 4:.1f}" for t in tables.values()])
            row("n a cell", [rate(t, (NOISE[0], 5))[1] for t in tables.values()])
            conditions = [(s, 5) for s in NOISE]
        else:
            for method, table in tables.items():  # L5 on the states that the other levels have
                states = {key for pairs in table[SEVEN[0], 1].values() for key in pairs}
                for condition, tasks in part_of(folder, method, "seven").items():
                    for task, pairs in tasks.items():
                        table[condition][task] = {key: v for key, v in pairs.items() if key in states}
            for level in LEVELS:
                row(f"L{level}", [f"{sum(rate(t, (s, level))[0] for s in SEVEN) / 7:.1f}" for t in tables.values()])
            row("n a cell", [7 * rate(t, (SEVEN[0], 1))[1] for t in tables.values()])
            conditions = [(s, level) for s in SEVEN for level in LEVELS]
        for method in tables:
            if method != "base" and "base" in tables:
                row(f"{method} - base", [cell(tables[method], tables["base"], conditions)])


def residual(runs):
    values = defaultdict(list)
    for run in runs:
        with open(pathlib.Path(run) / "episodes.csv", newline="") as file:
            for episode in csv.DictReader(file):
                if episode["residual"]:
                    values[episode["scenario"]].append(float(episode["residual"]))
    print("Residual [%], mean over rollouts")
    row("scenario", ["LIBERO", "paper pi0", "n"])
    order = [*PAPER_RESIDUAL, *(s for s in values if s not in PAPER_RESIDUAL)]
    means = {s: 100 * sum(values[s]) / len(values[s]) for s in order if values[s]}
    for scenario, mean in means.items():
        row(scenario, [f"{mean:.1f}", PAPER_RESIDUAL.get(scenario, ""), len(values[scenario])])
    if set(SEVEN) <= set(means):
        correlation = spearman([means[s] for s in SEVEN], [PAPER_RESIDUAL[s] for s in SEVEN])
        print(f"Rank correlation of the seven: {correlation:.2f}")


def main():
    if sys.argv[1:2] == ["--residual"]:
        return residual(sys.argv[2:])
    folder = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else KEPT
    methods = sorted(d.name for d in folder.iterdir() if d.is_dir() and list(d.glob("*.jsonl")))
    seven = {m: t for m in methods if (t := {c: tasks for (c, _), tasks in part_of(folder, m, "seven").items()})}
    if "base" not in seven:
        raise SystemExit(f"{folder} has no base/seven-*.jsonl: eval/conditions/libero_tables.sh base seven 0 2 {folder}")
    main_table(seven)
    comparisons(seven)
    other_tables(folder, methods)


if __name__ == "__main__":
    main()
