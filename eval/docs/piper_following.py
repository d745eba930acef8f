#!/usr/bin/env python3
"""The table of docs/results/arm-following.md from kept outcomes: eval/docs/piper_following.py"""

import json
import math
import pathlib
import random

METHOD = "ours_following_step"
DRAWS = 4000


def outcomes(mode):
    """{(arm, method): {task: [0 or 1, by initial state]}}"""
    table = {}
    file = pathlib.Path(__file__).parent / f"piper-following-{mode}.jsonl"
    for line in file.read_text().splitlines():
        unit = json.loads(line)
        arm = pathlib.Path(unit["scenario"]).stem
        tasks = table.setdefault((arm, unit["method"]), {})
        tasks[unit["suite"]] = [int(c) for c in unit["outcomes"][0]]
    return table


def differences(table, arm, reference):
    mine, other = table[arm, METHOD], table[arm, reference]
    return [[a - b for a, b in zip(mine[task], other[task])] for task in sorted(mine)]


def interval(strata):
    """Mean [points] and its 95 % bootstrap interval, drawn within each stratum."""
    count = sum(map(len, strata))
    drawn = sorted(sum(sum(random.choices(s, k=len(s))) for s in strata) for _ in range(DRAWS))
    return [100 * x / count for x in (sum(map(sum, strata)), drawn[DRAWS // 40], drawn[-DRAWS // 40 - 1])]


def exact_mcnemar(strata):
    won, lost = (sum(x == sign for s in strata for x in s) for sign in (1, -1))
    tail = sum(math.comb(won + lost, i) for i in range(min(won, lost) + 1))
    return min(1.0, 2 * tail / 2 ** (won + lost))


def main():
    random.seed(1)
    for mode in ("direct", "planned"):
        table, whole = outcomes(mode), []
        for arm in ("new", "used_one_year", "stiff", "slack"):
            rates = [sum(map(sum, table[arm, m].values())) for m in ("base", "dob", METHOD)]
            cells = []
            for reference in ("base", "dob"):
                strata = differences(table, arm, reference)
                cells.append("{:+.0f} [{:+.0f}, {:+.0f}]".format(*interval(strata)) + f" p {exact_mcnemar(strata):.2g}")
            whole += differences(table, arm, "base")
            print(f"{mode}, {arm}:", *rates, *cells, sep="  ")
        print(f"{mode}, all against base:", "{:+.1f} [{:+.1f}, {:+.1f}]".format(*interval(whole)))


if __name__ == "__main__":
    main()
