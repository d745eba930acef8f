#!/usr/bin/env python3
"""Clang's thread-safety analysis of every unit that can see an annotation.

  deploy/check/thread_safety.py BUILD [--jobs N] [--list]

BUILD is a configured build whose generated headers exist. A unit is analysed if it, or a file of this
tree that it includes at any depth, names a mutex or one of Abseil's annotations: in another unit there
is nothing to find. A mutex that no annotation names guards nothing that can be checked: that is a
finding too, except in tests. Exit codes: 0 no finding; 1 findings, as FILE:LINE; 2 it cannot begin.
"""

import argparse
import concurrent.futures
import os
import re
import subprocess
import sys
import time

from clang_units import ROOT, PrecompiledHeaders, missing, units

WARNINGS = ["-Wno-everything", "-Wthread-safety", "-Werror"]
INCLUDE = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.M)
ANNOTATED = re.compile(r"\babsl::(Reader|Writer)?Mutex|\bStdMutex|\bABSL_(PT_)?GUARDED_BY|"
                       r"\bABSL_(EXCLUSIVE|SHARED|LOCKS|NO_THREAD)_\w+")
MUTEX = re.compile(r"^\s*(?:mutable\s+|static\s+)*(?:absl::Mutex|StdMutex|std::(?:recursive_|shared_|timed_)*mutex)"
                   r"\s+(\w+)\s*[;{(]", re.M)


class Sources:
    """Files of the tree, and what they include of it."""

    def __init__(self, build):
        self._folders, self._text = [ROOT, os.path.join(build, "generated")], {}

    def text(self, path):
        if path not in self._text:
            with open(path, encoding="utf-8", errors="replace") as file:
                self._text[path] = file.read()
        return self._text[path]

    def _includes(self, path):
        for name in INCLUDE.findall(self.text(path)):
            for folder in (os.path.dirname(path), *self._folders):
                found = os.path.normpath(os.path.join(folder, name))
                if os.path.exists(found):
                    yield found
                    break

    def sees_annotation(self, unit):
        waiting, seen = [unit], {unit}
        while waiting:
            path = waiting.pop()
            if ANNOTATED.search(self.text(path)):
                return True
            new = [other for other in self._includes(path) if other not in seen]
            seen.update(new)
            waiting += new
        return False


def unnamed(sources, names):
    """Mutexes that no annotation of their file names, and std's, which has none."""
    for name in names:
        text = sources.text(os.path.join(ROOT, name))
        for match in MUTEX.finditer(text):
            mutex, line = match.group(1), text.count("\n", 0, match.start(1)) + 1
            if "not analysed:" in " ".join(text.split("\n")[line - 2:line]).lower():
                continue
            if "std::" in match.group():
                yield (f"{name}:{line}: {mutex} is a mutex of std, which has no annotations; take absl::Mutex, or "
                       "StdMutex for a timed wait, or say why neither in a comment with 'not analysed:'")
            elif not re.search(rf"\bABSL_\w+\([^)]*\b{mutex}\b", text):
                yield f"{name}:{line}: no annotation names {mutex}; say with ABSL_GUARDED_BY({mutex}) what it guards"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--list", action="store_true", help="print the units only")
    options = parser.parse_args()
    build = os.path.abspath(options.build)
    sources = Sources(build)
    chosen = [unit for unit in units(build) if sources.sees_annotation(unit[0])]
    if not chosen:
        missing(f"{build}: no unit of this build sees an annotation; is it a build of the whole tree?")
    if options.list:
        print("\n".join(os.path.relpath(unit[0], ROOT) for unit in chosen))
        return 0

    # A test may hold a mutex for what it alone reads before its threads begin and after they end.
    tracked = subprocess.run(["git", "ls-files", "-co", "--exclude-standard", "*.h", "*.cc"], cwd=ROOT,
                             capture_output=True, text=True, check=True).stdout.split()
    findings = list(unnamed(sources, [name for name in tracked if not name.startswith("tests/")
                                      and os.path.exists(os.path.join(ROOT, name))]))
    print("".join(f"{finding}\n" for finding in findings), end="")

    begin = time.monotonic()
    headers = PrecompiledHeaders(os.path.join(build, "clang_headers"))
    count = headers.make(chosen)
    print(f"{time.monotonic() - begin:6.1f} s  {count} precompiled headers", flush=True)

    def analyse(unit):
        path, flags, header = unit
        begin = time.monotonic()
        done = subprocess.run(["clang++", "-fsyntax-only", *flags, *WARNINGS, *headers.flags(path, header), path],
                              capture_output=True, text=True, check=False)
        return path, done, time.monotonic() - begin

    failed = 0
    with concurrent.futures.ThreadPoolExecutor(max(1, options.jobs)) as pool:
        for path, done, seconds in pool.map(analyse, chosen):
            print(f"{seconds:6.1f} s  {os.path.relpath(path, ROOT)}{'  FAILED' if done.returncode else ''}", flush=True)
            if done.returncode:
                failed += 1
                print(done.stderr, flush=True)
    print(f"{len(chosen)} units, {failed} with findings; {len(findings)} mutexes that no annotation names")
    return 1 if failed or findings else 0


if __name__ == "__main__":
    sys.exit(main())
