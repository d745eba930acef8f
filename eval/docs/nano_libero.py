#!/usr/bin/env python3
"""nano-libero in plain pictures and as the originals draw, docs/results/training-nano-libero.md: eval/docs/nano_libero.py

From the kept outcomes: successes of each suite and task; the difference on the same episodes, 95 % and p by the 40 tasks.
"""

import pathlib

from libero_tables import interval_text, part_of
from winning_back import differences

DOCS = pathlib.Path(__file__).parent
CLEAN = ("clean", 5)


def main():
    plain, original = (part_of(DOCS, "nano-libero", part) for part in ("states", "original"))
    for name, table in {"plain": plain, "as the originals draw": original}.items():
        tasks = {task: sum(states.values()) for task, states in table[CLEAN].items()}
        print(f"{name}: {sum(tasks.values())}")
        for suite in dict.fromkeys(suite for suite, _ in tasks):
            row = [n for (s, _), n in sorted(tasks.items()) if s == suite]
            print(f"  {suite} {sum(row)}: {', '.join(map(str, row))}")
    print(f"as the originals draw - plain: {interval_text(*differences(original, plain, [CLEAN]))}")


if __name__ == "__main__":
    main()
