#!/usr/bin/env python3
"""clang-tidy with the checks of .clang-tidy.

  deploy/check/tidy.py BUILD [--base REF | --all] [--jobs N] [PATH...]

BUILD is a configured build whose generated headers exist: for --all one with unity units (preset ci),
which are read in a third of the time, else one without (preset dev). Without PATHs the files that differ
from REF are read (default: origin/main, or the commit before where there is none), changes that are not
committed included; of a header that changed, the source of the same name. A PATH is a file or a folder.
A finding is printed once. Exit codes: 0 no finding; 1 findings; 2 it cannot begin.
"""

import argparse
import concurrent.futures
import os
import re
import subprocess
import sys
import time

from clang_units import ROOT, PrecompiledHeaders, missing, units

UNITY = f"{os.sep}Unity{os.sep}"
# A unity unit includes our sources: they are reported as headers are.
OURS = "--header-filter=^" + re.escape(ROOT + os.sep) + "[a-z_]+/.*[.](h|cc)$"
FINDING = re.compile(r"^(?=/[^\s:]+:\d+:\d+: (?:error|warning): )", re.M)


def git(*words):
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        missing(f"git {' '.join(words)}: {done.stderr.strip()}; name a base that exists: --base REF")
    return done.stdout.split()


def changed(base):
    if base is None:
        known = subprocess.run(["git", "rev-parse", "-q", "--verify", "origin/main"], cwd=ROOT, capture_output=True,
                               check=False).returncode == 0
        base = "origin/main" if known else "HEAD~1"
    fork = git("merge-base", base, "HEAD")[0]
    names = git("diff", "--name-only", fork) + git("ls-files", "-o", "--exclude-standard")
    return base, {os.path.join(ROOT, name[:-2] + ".cc" if name.endswith(".h") else name) for name in names}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("paths", nargs="*")
    parser.add_argument("--base")
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    options = parser.parse_args()
    build = os.path.abspath(options.build)
    known = units(build)
    if not options.all and any(UNITY in unit[0] for unit in known):
        missing(f"{build}: it has unity units, which only --all reads; configure one without: cmake --preset dev")
    if options.paths:
        wanted = [os.path.abspath(path) for path in options.paths]
        chosen = [unit for unit in known if any(unit[0] == path or unit[0].startswith(path + os.sep) for path in wanted)]
        if not chosen:
            missing(f"{' '.join(options.paths)}: no unit of {build} is there")
    elif options.all:
        chosen = known
    else:
        base, names = changed(options.base)
        chosen = [unit for unit in known if unit[0] in names]
        print(f"{len(chosen)} units differ from {base}")
    begin = time.monotonic()
    headers = PrecompiledHeaders(os.path.join(build, "clang_headers"))
    count = headers.make(chosen)
    print(f"{time.monotonic() - begin:6.1f} s  {count} precompiled headers", flush=True)

    def read(unit):
        path, flags, header = unit
        unity = ["--checks=-bugprone-suspicious-include", OURS] if UNITY in path else []
        begin = time.monotonic()
        done = subprocess.run(["clang-tidy", "--quiet", *unity, path, "--", *flags, "-Wno-everything",
                               *headers.flags(path, header)], cwd=ROOT, capture_output=True, text=True, check=False)
        return path, done, time.monotonic() - begin

    seen, broken = set(), 0
    with concurrent.futures.ThreadPoolExecutor(max(1, options.jobs)) as pool:
        for path, done, seconds in pool.map(read, chosen):
            print(f"{seconds:6.1f} s  {os.path.relpath(path, ROOT)}", flush=True)
            found = [words.rstrip() for words in FINDING.split(done.stdout) if words.strip()]
            for words in found:
                if words not in seen:
                    print(words, flush=True)
                    seen.add(words)
            if done.returncode and not found:
                broken += 1
                print(done.stderr, flush=True)
    print(f"{len(chosen)} units, {len(seen)} findings" + (f", {broken} that clang-tidy could not read" * bool(broken)))
    return 1 if seen or broken else 0


if __name__ == "__main__":
    sys.exit(main())
