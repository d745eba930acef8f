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

from winning_back import FOLDER as EMBEDDED, SEVEN, cell, differences, holm, interval, outcomes, rate, sign_flip_p

KEPT = pathlib.Path(__file__).parent / "libero-tables"
NOISE = ["isolated_stribeck", "isolated_backlash", "isolated_compliance", "isolated_gravity"]
PAPER = {"paper pi0.5": dict(zip(["clean", *SEVEN], [97.0, 44.1, 54.1, 83.4, 33.2, 29.5, 43.9, 55.6])),
         "paper pi0": dict(zip(["clean", *SEVEN], [91.1, 42.3, 46.1, 75.5, 26.8, 23.0, 34.5, 43.9]))}
PAPER_NOISE = dict(zip(NOISE, [36.8, 68.0, 74.1, 21.1]))  # pi0's base, tab:unit
PAPER_RESIDUAL = dict(zip(["clean", *SEVEN], [23.4, 48.6, 47.5, 46.1, 38.7, 48.2, 56.3, 47.0]))  # tab:residual-magnitude
# As declared before the runs: the primary comparison, and Holm's family of three.
PRIMARY = ("ours_replanning", "base")
SECONDARY = [("ours_replanning", "gain"), ("ours_replanning", "smooth_fewer_rows"), ("smooth_fewer_rows", "base")]
# Thought of after the results of smooth_fewer_rows and of ours_replanning.
EXPLORED = [("ours_replanning", "gain_two_rows"), ("gain_two_rows", "smooth_fewer_rows"), ("ours_panda", "ours_replanning"),
            ("ours_panda", "gain_two_rows")]
# At the paper's length, as declared: Holm over the two of each family; states 0 and 1 had been seen before.
LENGTH = [[("paper", "base"), ("ours_replanning", "base")],
          [("ours_panda", "gain_two_rows"), ("ours_panda", "ours_replanning")]]
# Where the paper says that its own gap widens with severity, and where that it stays (sec:supp_severity_levels).
GROUPS = {"heavy_payload and aged_joint_*": ["heavy_payload", "aged_joint_uniform", "aged_joint_shoulder", "aged_joint_elbow"],
          "thermal_drift_*": ["thermal_drift_stribeck", "thermal_drift_backlash"]}


def unseen_states(task, state):
    return state >= 2


def first_states(task, state):
    return state < 2


def last_tasks(task, state):
    return task >= 5


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


def refuse_unlike(part, tables):
    """Ends where a method lacks a condition, task or episode that another one of the part has."""
    keys = {m: {(c, *task, key) for c, tasks in t.items() for task, pairs in tasks.items() for key in pairs}
            for m, t in tables.items()}
    for method, mine in keys.items():
        if missing := sorted(set.union(*keys.values()) - mine, key=str):
            condition, suite, task, (seed, state) = missing[0]
            raise SystemExit(f"{part}: {method} lacks {len(missing)} episodes that another method has, the first: {condition}, "
                             f"{suite} task {task}, seed {seed}, state {state}; run eval/conditions/libero_tables.sh again")


def refuse_other_weights(folder):
    first = {}
    for file in sorted(folder.glob("*/*.jsonl")):
        for line in file.read_text().splitlines():
            unit = json.loads(line)
            if unit["policy"] != "expert":
                first.setdefault((unit["policy"], unit["model"]), f"{file}: {unit['unit']}")
    if len(first) > 1:
        raise SystemExit(f"outcomes of {len(first)} policies or weights: {first}; keep each in a folder of its own")


def updates_table(folder, methods):
    print("\nUpdates in a suite's episodes of part seven: least, mean, most")
    for method in methods:
        counts = [json.loads(line)["updates"] for file in (folder / method).glob("seven-*.jsonl")
                  for line in file.read_text().splitlines()]
        if any(counts):
            row(method, [min(counts), f"{sum(counts) / len(counts):.0f}", max(counts)])


def processors(folder):
    """Which methods of which part ran on which kind: predictions round otherwise there, so that a pair shares its state only."""
    kinds, parts = [], defaultdict(lambda: defaultdict(list))
    for file in sorted(folder.glob("*/*.jsonl")):
        for kind in sorted({k for line in file.read_text().splitlines() for k in json.loads(line).get("machines", [])}):
            if kind not in kinds:
                kinds.append(kind)
            parts[file.stem.rpartition("-")[0]][kinds.index(kind)].append(file.parent.name)
    if len(kinds) > 1:
        print("\nKinds of processor", *(f"{chr(65 + n)}: {kind}" for n, kind in enumerate(kinds)), sep="\n")
        for part, methods in parts.items():
            row(part, [f"{chr(65 + n)}: {', '.join(methods[n])}" for n in sorted(methods)])


def repeated(seven, lengths):
    """States 0 and 1 ran in part seven and at the paper's length: how many outcomes differ."""
    print("\nOutcomes of states 0 and 1 that differ between part seven and the paper's length")
    for method, table in seven.items():
        cells = []
        for scenario, tables in lengths.items():
            if method in tables and scenario in table:
                keys = [(t, k) for t, pairs in table[scenario].items() for k in pairs.keys() & tables[method][scenario][t].keys()]
                other = sum(table[scenario][t][k] != tables[method][scenario][t][k] for t, k in keys)
                cells.append(f"{scenario} {other} of {len(keys)}")
        if cells:
            row(method, cells)


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


def against_others(tables, conditions):
    """Each method minus base, and EXPLORED: all conditions together, then each, p by Holm over them. conditions: {name: [keys]}."""
    pairs = [(m, "base") for m in tables if m != "base" and "base" in tables] + [p for p in EXPLORED if set(p) <= set(tables)]
    for a, b in pairs:
        mine, other = tables[a], tables[b]
        p_values = holm([sign_flip_p(differences(mine, other, keys)[0]) for keys in conditions.values()])
        if len(conditions) > 1:
            row(f"{a} - {b}", ["all", cell(mine, other, [k for keys in conditions.values() for k in keys])])
        for (name, keys), p in zip(conditions.items(), p_values):
            note = f"by Holm over {len(conditions)} {p:.2g}" if len(conditions) > 1 else f"p {p:.2g}"
            row(f"{a} - {b}", [name, cell(mine, other, keys, False), note])


def noise_table(folder, methods):
    tables = {m: t for m in methods if (t := part_of(folder, m, "noise"))}
    if not tables:
        return
    refuse_unlike("noise", tables)
    print("\nEach error alone, L5: success [%]")
    row("", tables)
    for scenario in NOISE:
        row(scenario, [f"{rate(t, (scenario, 5))[0]:.1f}" for t in tables.values()])
    row("mean", [f"{sum(rate(t, (s, 5))[0] for s in NOISE) / 4:.1f}" for t in tables.values()])
    row("n a cell", [rate(t, (NOISE[0], 5))[1] for t in tables.values()])
    against_others(tables, {s: [(s, 5)] for s in NOISE})
    if "base" in tables:
        lost = [-rate(tables["base"], (s, 5))[0] for s in NOISE]
        print(f"Rank correlation of base's four losses with the paper's: {spearman(lost, [-PAPER_NOISE[s] for s in NOISE]):.2f}")


def interval_text(values, pairs):
    return "{:+.1f} [{:+.1f}, {:+.1f}] p {:.2g}".format(*interval(values, pairs), sign_flip_p(values))


def growth(mine, other, scenarios, first):
    """What the difference of two methods at L5 is more than at the first level."""
    (low, pairs), (high, _) = (differences(mine, other, [(s, n) for s in scenarios]) for n in (first, 5))
    return interval_text({task: high[task] - low[task] for task in high | low}, pairs)


def severity_table(folder, methods):
    """The levels that there are; L5 of part seven."""
    levels = {m: {n for n in range(1, 5) if part_of(folder, m, f"level_{n}")} for m in methods}
    levels = {m: numbers for m, numbers in levels.items() if numbers}
    if not levels:
        return
    shared = [*sorted(set.union(*levels.values())), 5]
    tables = {m: {c: tasks for part in (*(f"level_{n}" for n in shared[:-1]), "seven")
                  for c, tasks in part_of(folder, m, part).items()} for m in levels}
    refuse_unlike("levels", tables)
    print("\nSeverity: success [%], mean of the seven and each")
    row("", [f"L{n}" for n in shared])
    for method, table in tables.items():
        row(method, [f"{sum(rate(table, (s, n))[0] for s in SEVEN) / 7:.1f}" for n in shared])
        for scenario in SEVEN:
            row(f"{method}, {scenario}", [f"{rate(table, (scenario, n))[0]:.1f}" for n in shared])
        row("n a cell of a scenario", [rate(table, (SEVEN[0], n))[1] for n in shared])
    against_others(tables, {f"L{n}": [(s, n) for s in SEVEN] for n in shared})
    for method in tables:
        if method != "base" and "base" in tables:
            for name, scenarios in {"all": SEVEN, **GROUPS, **{s: [s] for s in SEVEN}}.items():
                row(f"{method} - base, L5 less L{shared[0]}", [name, growth(tables[method], tables["base"], scenarios, shared[0])])
    if "base" in tables:
        for n, following in zip(shared, shared[1:]):
            differing, pairs = differences(*({s: tables["base"][s, level] for s in SEVEN} for level in (following, n)), SEVEN)
            row(f"base, L{following} less L{n}", [interval_text(differing, pairs)])


def only(tables, keep):
    """The same tables with the episodes of which keep(number of the task, state) holds."""
    return {m: {c: {task: kept for task, pairs in tasks.items()
                    if (kept := {key: v for key, v in pairs.items() if keep(task[1], key[1])})} for c, tasks in t.items()}
            for m, t in tables.items()}


def length_table(folder, methods, scenario):
    """The paper's length under one scenario: all tasks, the last five of each suite, the states of part seven and the others."""
    tables = {m: t for m in methods if (t := {c: tasks for (c, _), tasks in part_of(folder, m, scenario).items()})}
    if not tables:
        return {}
    refuse_unlike(scenario, tables)
    print(f"\n{scenario} at the paper's length: success [%], n")
    for method, table in tables.items():
        suites = sorted({suite for suite, _ in table[scenario]})
        rates = [rate({scenario: {k: v for k, v in table[scenario].items() if k[0] == s}}, scenario) for s in suites]
        row(method, ["{:.1f}, {}".format(*rate(table, scenario)), *(f"{s} {r:.1f}, {n}" for s, (r, n) in zip(suites, rates))])
    against_others(tables, {"all tasks": [scenario]})
    against_others(only(tables, last_tasks), {"the last five tasks of each suite": [scenario]})
    against_others(only(tables, first_states), {"states 0 and 1": [scenario]})
    against_others(only(tables, unseen_states), {"states from 2 on": [scenario]})
    return tables


def length_summary(lengths, family, conditions):
    """Over those of the conditions that base and every method of the family have."""
    methods = list(dict.fromkeys(["base", *(method for pair in family for method in pair)]))
    played = [s for s in conditions if set(methods) <= set(lengths[s])]
    if not played:
        return
    tables = {m: {s: lengths[s][m][s] for s in played} for m in methods}
    print(f"\nThe paper's length, mean over {len(played)} of {len(conditions)}: {', '.join(played)}")
    for method, table in tables.items():
        row(method, [f"{sum(rate(table, s)[0] for s in played) / len(played):.1f}", f"n {len(played) * rate(table, played[0])[1]}"])
    if "base" in lengths["clean"] and played == SEVEN:
        lost = losses({"clean": rate(lengths["clean"]["base"], "clean")[0], **{s: rate(tables["base"], s)[0] for s in SEVEN}})
        row("Rank correlation of the seven losses of base", [f"{name} {spearman(lost, losses(s)):.2f}" for name, s in PAPER.items()])
    pairs = family + [(m, "base") for m in methods[1:] if (m, "base") not in family]
    for name, keep in (("states from 2 on", unseen_states), ("all", lambda task, state: True),
                       ("the last five tasks of each suite", last_tasks), ("states 0 and 1", first_states)):
        part = only(tables, keep)
        p_values = holm([sign_flip_p(differences(part[a], part[b], played)[0]) for a, b in family])
        corrected = {pair: f"by Holm over {len(family)} {p:.2g}" for pair, p in zip(family, p_values)}
        for a, b in pairs:
            row(f"{a} - {b}", [name, cell(part[a], part[b], played), corrected.get((a, b), "beside")])
    part = only(tables, unseen_states)
    for a, b in pairs:
        p_values = holm([sign_flip_p(differences(part[a], part[b], [s])[0]) for s in played])
        for scenario, p in zip(played, p_values):
            row(f"{a} - {b}", [f"states from 2 on, {scenario}", cell(part[a], part[b], [scenario], False),
                               f"by Holm over {len(played)} {p:.2g}"])


def residual(runs):
    values = defaultdict(list)
    for run in runs:
        table = pathlib.Path(run) / "episodes.csv"
        if not table.is_file():
            raise SystemExit(f"{table} is missing: {run} is no run of eval/conditions/libero_tables.sh, or not finished")
        with open(table, newline="") as file:
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
    if not folder.is_dir():
        raise SystemExit(f"{folder} is no folder; eval/conditions/libero_tables.sh METHOD PART FIRST EPISODES {folder} fills it")
    methods = sorted(d.name for d in folder.iterdir() if d.is_dir() and list(d.glob("*.jsonl")))
    seven = {m: t for m in methods if (t := {c: tasks for (c, _), tasks in part_of(folder, m, "seven").items()})}
    if "base" not in seven:
        raise SystemExit(f"{folder} has no base/seven-*.jsonl: eval/conditions/libero_tables.sh base seven 0 2 {folder}")
    refuse_other_weights(folder)
    refuse_unlike("seven", seven)
    main_table(seven)
    comparisons(seven)
    updates_table(folder, methods)
    noise_table(folder, methods)
    severity_table(folder, methods)
    lengths = {scenario: length_table(folder, methods, scenario) for scenario in ["clean", *SEVEN, *NOISE]}
    for family in LENGTH:
        length_summary(lengths, family, SEVEN)
    length_summary(lengths, [PRIMARY], NOISE)
    repeated(seven, lengths)
    processors(folder)


if __name__ == "__main__":
    main()
