#!/usr/bin/env python3
"""A film of every episode that LIBERO's experts fail in docs/results/libero-experts.md, of the outcomes kept for it.

    eval/conditions/libero_expert_films.py OUT [OPTIONS OF SWEEP...]     27 films, six minutes of a core

The films: OUT/SUITE-TASK-STATE.webp. What is there is not drawn again. They show LIBERO's objects, so none is kept here.
"""

import pathlib
import shutil
import subprocess
import sys

DOCS = pathlib.Path(__file__).resolve().parents[1] / "docs"
sys.path.append(str(DOCS))
from libero_tables import part_of  # noqa: E402


def failures():
    """(suite, task, state) of each."""
    for (suite, task), outcomes in part_of(DOCS, "libero-experts", "states")["clean", 5].items():
        yield from ((suite, task, state) for (_, state), outcome in outcomes.items() if not outcome)


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
