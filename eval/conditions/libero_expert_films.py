#!/usr/bin/env python3
"""A film of every episode that LIBERO's experts fail in docs/results/libero-experts.md, of the outcomes kept for it.

    eval/conditions/libero_expert_films.py OUT [OPTIONS OF SWEEP...]     27 films, six minutes of a core

The films: OUT/SUITE-TASK-STATE.webp. What is there is not drawn again. They show LIBERO's objects, so none is kept here.
"""

import json
import pathlib
import shutil
import subprocess
import sys

KEPT = pathlib.Path(__file__).resolve().parents[1] / "docs" / "libero-experts"


def failures():
    """(suite, task, state) of each."""
    for file in sorted(KEPT.glob("*.jsonl")):
        for line in file.read_text().splitlines():
            unit = json.loads(line)
            for task, outcomes in zip(unit["tasks"], unit["outcomes"]):
                for i, outcome in enumerate(outcomes):
                    if outcome == "0":
                        yield unit["suite"], task, unit["first_initial_state"] + i


def main():
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        raise SystemExit(__doc__)
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    for suite, task, state in failures():
        film, run = out / f"{suite}-{task}-{state}.webp", out / f"{suite}-{task}-{state}"
        if film.exists():
            continue
        command = ["robostress", "sweep", "--no-report", "--quiet", "--suites", suite, "--tasks", f"{task}-{task}",
                   "--first-initial-state", str(state), "--episodes", "1", "--videos", "1", "--scenarios", "clean", "--policies",
                   "expert", "--methods", "base", "--set", "sim.pictures=plain", "--out", str(run), *sys.argv[2:]]
        subprocess.run(command, check=True)
        shutil.copy(next(run.glob("units/*/videos/*.webp")), film)
        shutil.rmtree(run)
        print(film, flush=True)


if __name__ == "__main__":
    main()
