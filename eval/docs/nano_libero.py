#!/usr/bin/env python3
"""nano-libero in plain pictures and as the originals draw, docs/results/training-nano-libero.md: eval/docs/nano_libero.py

From the kept outcomes: successes of each suite and task; the difference on the same episodes, 95 % and p by the 40 tasks.
"""

import json
import pathlib
from collections import defaultdict

from winning_back import interval, sign_flip_p

KEPT = pathlib.Path(__file__).parent / "nano-libero"
FILES = {"plain": ["states-40-45.jsonl", "states-46-49.jsonl"], "as the originals draw": ["original-pictures.jsonl"]}


def outcomes(files):
    """{(suite, task): {state: 0 or 1}} and the kinds of processor."""
    table, kinds = defaultdict(dict), set()
    for file in files:
        for line in (KEPT / file).read_text().splitlines():
            unit = json.loads(line)
            kinds.update(unit.get("machines", []))
            for task, row in zip(unit["tasks"], unit["outcomes"]):
                for i, outcome in enumerate(row):
                    table[unit["suite"], task][unit["first_initial_state"] + i] = int(outcome)
    return table, kinds


def main():
    tables = {}
    for name, files in FILES.items():
        tables[name], kinds = outcomes(files)
        suites = list(dict.fromkeys(suite for suite, _ in tables[name]))
        print(f"{name}, on {len(kinds)} kind of processor: {'; '.join(sorted(kinds))}")
        for suite in suites:
            of_tasks = [sum(states.values()) for (s, _), states in sorted(tables[name].items()) if s == suite]
            print(f"  {suite} {sum(of_tasks)}: {', '.join(map(str, of_tasks))}")
        print(f"  all {sum(sum(states.values()) for states in tables[name].values())}")
    plain, original = tables.values()
    sums = {task: sum(o - plain[task][state] for state, o in states.items()) for task, states in original.items()}
    estimate, low, high = interval(sums, sum(map(len, original.values())))
    print(f"as the originals draw - plain: {estimate:+.1f} [{low:+.1f}, {high:+.1f}], p {sign_flip_p(sums):.2g}")


if __name__ == "__main__":
    main()
