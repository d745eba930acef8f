#!/usr/bin/env python3
"""The tables of docs/results/winning-back.md from kept outcomes: eval/docs/winning_back.py [METHOD...]
    eval/docs/winning_back.py --first-seed [METHOD...]     initial states 20-26 with seed 0, which all methods played
    eval/docs/winning_back.py --picture FILE.svg     where the loss of each scenario goes

Reads winning-back/METHOD/*.jsonl beside this file, as eval/conditions/reporting_run.sh writes them. Clusters are the
40 tasks; scenarios and seeds lie within them. Pairs: equal condition, task, initial state and seed.
"""

import html
import json
import pathlib
import random
import sys
from collections import defaultdict

FOLDER = pathlib.Path(__file__).parent / "winning-back"
DRAWS = 20000
SEVEN = ["heavy_payload", "thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
         "aged_joint_uniform", "aged_joint_shoulder", "aged_joint_elbow"]
UNSEEN = ["stick", "payload", "velocity", "wear"]


def outcomes(method, folder=FOLDER, states=None):
    """{condition: {(suite, task): {(seed, state, file): 0 or 1}}}; condition: a scenario, or of UNSEEN. states: these alone."""
    table = defaultdict(lambda: defaultdict(dict))
    for file in sorted((folder / method).glob("*.jsonl")):
        part = file.stem.split("-")[0]
        for line in file.read_text().splitlines():
            unit = json.loads(line)
            condition = unit["scenario"] if part == "seven" else part
            for task, row in zip(unit["tasks"], unit["outcomes"]):
                for i, outcome in enumerate(row):
                    key = unit["seed"], unit["first_initial_state"] + i, pathlib.Path(unit["scenario"]).name
                    if states is None or key[1] in states:
                        table[condition][unit["suite"], task][key] = int(outcome)
    return table


def rate(table, condition):
    values = [v for task in table[condition].values() for v in task.values()]
    return 100 * sum(values) / len(values), len(values)


def differences(mine, other, conditions):
    """{task: sum of differences over the pairs of all conditions}, and the number of pairs. Every condition has
    equally many pairs, so that their sum weighs each the same."""
    sums, counts = defaultdict(int), defaultdict(int)
    for condition in conditions:
        counts[condition] += 0
        for task, pairs in mine[condition].items():
            for key in pairs.keys() & other[condition][task].keys():
                sums[task] += pairs[key] - other[condition][task][key]
                counts[condition] += 1
    if len(set(counts.values())) > 1:
        raise SystemExit(f"conditions have different numbers of pairs: {dict(counts)}")
    return sums, sum(counts.values())


def interval(sums, pairs):
    """Estimate [points] and the 95 % percentile interval of whole tasks drawn with replacement."""
    values = list(sums.values())
    stream = random.Random(1)
    drawn = sorted(sum(stream.choices(values, k=len(values))) for _ in range(DRAWS))
    return [100 * x / pairs for x in (sum(values), drawn[DRAWS // 40], drawn[-DRAWS // 40 - 1])]


def sign_flip_p(sums):
    """Exact: the signs of all differences of a task flipped together."""
    sizes = [abs(v) for v in sums.values()]
    ways = {0: 1}
    for size in sizes:
        after = defaultdict(int)
        for total, count in ways.items():
            after[total + size] += count
            after[total - size] += count
        ways = after
    seen = abs(sum(sums.values()))
    return sum(count for total, count in ways.items() if abs(total) >= seen) / 2 ** len(sizes)


def holm(p_values):
    corrected, largest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = largest
    return corrected


def cell(mine, other, conditions, p=True):
    sums, pairs = differences(mine, other, conditions)
    text = "{:+.1f} [{:+.1f}, {:+.1f}]".format(*interval(sums, pairs))
    return f"{text} p {sign_flip_p(sums):.2g}" if p else text


def per_condition(mine, other, conditions):
    """Cells with Holm's correction over the conditions."""
    p_values = [sign_flip_p(differences(mine, other, [c])[0]) for c in conditions]
    return {c: f"{cell(mine, other, [c], False)} p {p:.2g}" for c, p in zip(conditions, holm(p_values))}


# What a loss is made of. Above what is won, the better of two that know what no method of this page does, where it does
# better: the true errors and their states, inverted; or where all objects are (the expert). The rest none of the three wins.
PARTS = [("won back by ours_replanning", "#1d4ed8"),
         ("missed: the true errors, inverted, do better", "#0f766e"),
         ("missed: knowing where everything is (the expert) does better", "#b45309"),
         ("none of the three wins it", "#6b7280")]


def losses(tables):
    """{scenario or "mean": (success of base, success without errors, [points of each part])}, on episodes that all share.
    Without errors: ours_replanning in Clean."""
    result = {}
    for scenario in SEVEN:
        shared = set.intersection(*({(task, key[:2]) for task, row in tables[n][scenario].items() for key in row}
                                    for n in tables))
        shared &= {(task, key[:2]) for task, row in tables["ours_replanning"]["clean"].items() for key in row}

        def success(name, condition):
            return 100 * sum(v for task, row in tables[name][condition].items() for key, v in row.items()
                             if (task, key[:2]) in shared) / len(shared)
        base, won, known, seen = (success(n, scenario) for n in ("base", "ours_replanning", "known_errors", "expert"))
        off = success("ours_replanning", "clean")
        levels = [base, won, max(won, known), max(won, known, seen)]
        levels.append(max(levels[-1], off))
        result[scenario] = base, levels[-1], [after - before for before, after in zip(levels, levels[1:])]
    count = len(result)
    result["mean"] = (*(sum(r[i] for r in result.values()) / count for i in (0, 1)),
                      [sum(r[2][k] for r in result.values()) / count for k in range(len(PARTS))])
    return result


def picture(rows):
    left, row, scale = 250, 34, 8.0
    width = left + scale * max(sum(parts) for _, _, parts in rows.values()) + 30
    height = row * len(rows) + 64 + 20 * len(PARTS)
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {height}" width="{width:.0f}" height="{height}" '
           'font-family="system-ui, DejaVu Sans, sans-serif" font-size="13">',
           f'<rect width="{width:.0f}" height="{height}" fill="#ffffff"/>']

    def text(x, y, words, anchor="start", colour="#1f2937"):
        out.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{html.escape(words)}</text>')

    text(12, 22, "Success lost to each scenario [points], and where it goes")
    for i, (scenario, (base, off, parts)) in enumerate(rows.items()):
        y, x = 40 + row * i, left
        text(left - 10, y + 17, f"{scenario.replace('_', ' ')}  {base:.0f} of {off:.0f} %", "end")
        for points, (_, colour) in zip(parts, PARTS):
            out.append(f'<rect x="{x:.1f}" y="{y}" width="{scale * points:.1f}" height="24" fill="{colour}"/>')
            if points >= 2:
                text(x + scale * points / 2, y + 17, f"{points:.0f}", "middle", "#ffffff")
            x += scale * points
    bottom = 40 + row * len(rows)
    for k, (words, colour) in enumerate(PARTS):
        y = bottom + 14 + 20 * k
        out.append(f'<rect x="{left}" y="{y}" width="13" height="13" fill="{colour}"/>')
        text(left + 20, y + 11, words)
    return "\n".join(out + ["</svg>"]) + "\n"


def main():
    if sys.argv[1:2] == ["--picture"]:
        rows = losses({name: outcomes(name) for name in ("base", "ours_replanning", "known_errors", "expert")})
        pathlib.Path(sys.argv[2]).write_text(picture(rows))
        for scenario, (base, off, parts) in rows.items():
            print(scenario, f"{base:.1f} of {off:.1f}", *(f"{x:+.1f}" for x in parts), sep=" | ")
        return
    first_seed = sys.argv[1:2] == ["--first-seed"]
    methods = sys.argv[1 + first_seed:] or sorted(d.name for d in FOLDER.iterdir() if d.is_dir())
    unknown = [method for method in methods if not (FOLDER / method).is_dir()]
    if unknown:
        raise SystemExit(f"no outcomes of {unknown}; there are: {sorted(d.name for d in FOLDER.iterdir())}")
    tables = {method: outcomes(method, states=range(20, 27) if first_seed else None) for method in methods}
    for family, conditions in (("the seven", SEVEN), ("unseen", UNSEEN)):
        have = [m for m in methods if all(c in tables[m] for c in conditions)]
        shown = (["clean"] if family == "the seven" else []) + conditions
        print(f"\n{family}: success [%]\nmethod", *shown, "mean", "n a cell", sep=" | ")
        for m in have:
            rates = [rate(tables[m], c) for c in shown]
            mean = sum(r for (r, _), c in zip(rates, shown) if c != "clean") / len(conditions)
            print(m, *(f"{r:.1f}" for r, _ in rates), f"{mean:.1f}", rates[0][1], sep=" | ")
        for reference in have:
            print(f"\n{family}: against {reference} on the same episodes [points, 95 %, p]; each with Holm's over them")
            for m in have:
                if m == reference:
                    continue
                alone = per_condition(tables[m], tables[reference], conditions)
                clean = [f"clean {cell(tables[m], tables[reference], ['clean'])}"] if family == "the seven" else []
                print(f"{m}: mean {cell(tables[m], tables[reference], conditions)}", *clean,
                      *(f"{c} {text}" for c, text in alone.items()), sep="\n  ")


if __name__ == "__main__":
    main()
