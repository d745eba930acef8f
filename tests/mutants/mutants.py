#!/usr/bin/env python3
"""Breaks lines on purpose and asks the tests whether they notice.

A list has one mutant per block of lines, blocks apart by an empty line:

  file: robot_client/control/command_limiter.cc
  from: axis.upper = arm.upper[i] - margin;
  to:   axis.upper = arm.upper[i] - margin + 0.05;
  test: robot_client_control_test
  why:  the arm drives into its stop

`from` stands once in its file; `why` says what the change would do to somebody. `test` is a test
program, with or without arguments behind it (a filter of GoogleTest), or several with commas between.

The tree is copied to --copy (only what changed, so that its build stays warm), one mutant at a time
is put into the copy, what the test depends on is built and the test run. A line per mutant: killed
(the test fails), ALIVE (it passes) or no mutant (it does not compile). Verdicts go to --results;
what stands there is not run again. Before the first mutant of a test the test itself must pass.

Exit code: 0 if all are killed, 1 if not, 2 for a list that does not fit the sources.
"""
import argparse
import collections
import json
import os
import pathlib
import shutil
import subprocess
import sys
import time

EXAMPLES = """examples:
  tests/mutants/mutants.py                                   every list; call it again to go on
  tests/mutants/mutants.py tests/mutants/eval.txt --again alive
  tests/mutants/mutants.py tests/mutants/arm.txt --only watchdogs --again
"""
FIELDS = ("file", "from", "to", "test", "why")


def read_list(path):
    for block in path.read_text().split("\n\n"):
        mutant = {"list": path.stem}
        for line in block.splitlines():
            if line.strip() and not line.startswith("#"):
                key, _, value = line.partition(":")
                mutant[key.strip()] = value.strip()
        if len(mutant) == 1:
            continue
        missing, unknown = set(FIELDS[:4]) - mutant.keys(), mutant.keys() - {"list", *FIELDS}
        if missing or unknown:
            refuse(f"{path}: a block lacks {sorted(missing)} and has unknown {sorted(unknown)}: {block}")
        yield mutant


def misfits(mutants):
    """What no longer fits the sources, a line each."""
    for mutant in mutants:
        file = pathlib.Path(mutant["file"])
        found = file.read_text().count(mutant["from"]) if file.is_file() else None
        if found is None:
            yield f"{mutant['list']}.txt: no file {file}"
        elif found != 1:
            yield f"{mutant['list']}.txt: '{mutant['from']}' stands {found} times in {file}, must be once"


def refuse(why):
    print(why)
    sys.exit(2)


def identity(mutant):
    return tuple(mutant[field] for field in FIELDS[:4])


def mirror(tree):
    """Makes `tree` hold what this checkout holds; files that are equal keep their times."""
    listed = subprocess.run(["git", "ls-files", "-zco", "--exclude-standard"], check=True,
                            capture_output=True, text=True).stdout
    names = {name for name in listed.split("\0") if os.path.isfile(name)}
    for name in names:
        source, target = pathlib.Path(name), tree / name
        if not target.is_file() or target.read_bytes() != source.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target)
            os.utime(target)
    known = tree / ".mirrored"
    for name in set(known.read_text().split("\0") if known.exists() else []) - names:
        (tree / name).unlink(missing_ok=True)
    known.write_text("\0".join(names))


class Tree:
    """A source tree with a build folder in it."""

    def __init__(self, root, build, timeout):
        self.root, self.build, self.timeout = root, build, timeout
        self.passing, self.entries = {}, {}

    def run(self, *command, timeout=None, environment=()):
        try:
            return subprocess.run(command, cwd=self.root, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=timeout,
                                  env={**os.environ, **dict(each.split("=", 1) for each in environment)}).returncode == 0
        except subprocess.TimeoutExpired:
            return False

    def commands(self, test):
        """Program, arguments and environment of each of ctest's entries in `test`; arguments there replace the entry's own
        filter."""
        if not self.entries:
            listed = subprocess.run(["ctest", "--test-dir", self.build, "--show-only=json-v1"], cwd=self.root,
                                    check=True, capture_output=True, text=True).stdout
            self.entries = {entry["name"]: entry for entry in json.loads(listed)["tests"]}
        for part in test.split(","):
            name, *arguments = part.split()
            if not self.entries.get(name, {}).get("command"):
                refuse(f"ctest has no program for {name}: build {self.root / self.build} first")
            program, *own = self.entries[name]["command"]
            environment = next((p["value"] for p in self.entries[name]["properties"] if p["name"] == "ENVIRONMENT"), [])
            yield program, arguments or own, environment

    def builds(self, test):
        # Python's tests install the library, and name the programs that they ask.
        targets = set()
        for program, _, environment in self.commands(test):
            named = [pathlib.Path(each.split("=", 1)[1]) for each in environment]
            targets |= {path.name for path in named if path.parent.name in ("bin", "test_bin") and "venv" not in str(path)}
            name = pathlib.Path(program).name
            targets.add("robostress_c" if name.startswith("python") else name)
        return self.run("ninja", "-C", self.build, *sorted(targets))

    def passes(self, test):
        return all(self.run(program, *arguments, timeout=self.timeout, environment=environment)
                   for program, arguments, environment in self.commands(test))

    def verdict(self, mutant):
        test, path = mutant["test"], self.root / mutant["file"]
        if test not in self.passing:
            self.passing[test] = self.builds(test) and self.passes(test)
        if not self.passing[test]:
            return "no test"
        original = path.read_text()
        try:
            path.write_text(original.replace(mutant["from"], mutant["to"]))
            if not self.builds(test):
                return "no mutant"
            return "ALIVE" if self.passes(test) else "killed"
        finally:
            path.write_text(original)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    here = pathlib.Path(__file__).parent
    parser.add_argument("lists", nargs="*", type=pathlib.Path, metavar="LIST",
                        default=sorted(p for p in here.glob("*.txt") if p.stem != "CMakeLists"),
                        help="files of mutants (default: all beside this script)")
    parser.add_argument("--only", default="", metavar="TEXT",
                        help="mutants whose file or line holds TEXT")
    parser.add_argument("--check", action="store_true",
                        help="only see whether the lists fit the sources")
    parser.add_argument("--again", nargs="?", const="all", choices=["all", "alive"],
                        help="run also what the results hold: everything, or what was not killed")
    parser.add_argument("--copy", default="build/mutants", type=pathlib.Path, metavar="DIR",
                        help="where the copy of the tree lives (default: %(default)s)")
    parser.add_argument("--in-place", action="store_true",
                        help="change this checkout instead of a copy, and put each file back")
    parser.add_argument("--preset", default="release", help="of CMake (default: %(default)s)")
    parser.add_argument("--results", default="build/mutants.jsonl", type=pathlib.Path,
                        metavar="FILE", help="verdicts, one a line (default: %(default)s)")
    parser.add_argument("--timeout", default=300, type=float, metavar="SECONDS",
                        help="a test that takes longer has failed (default: %(default)s)")
    options = parser.parse_args()

    mutants = [m for path in options.lists for m in read_list(path)
               if options.only in m["file"] + m["from"] + m["to"]]
    if wrong := list(misfits(mutants)):
        refuse("\n".join(wrong))
    if options.check:
        print(f"{len(mutants)} mutants fit the sources")
        return 0
    known = {}
    if options.results.exists():
        for line in options.results.read_text().splitlines():
            result = json.loads(line)
            known[identity(result)] = result["verdict"]
    keep = {None: {"killed", "ALIVE"}, "alive": {"killed"}, "all": set()}[options.again]
    due = [m for m in mutants if known.get(identity(m)) not in keep]

    root = pathlib.Path(".") if options.in_place else options.copy
    if due and not options.in_place:
        mirror(root)
    tree = Tree(root.resolve(), f"build/{options.preset}", options.timeout)
    if due and not (tree.root / tree.build / "build.ninja").exists():
        if not tree.run("cmake", "--preset", options.preset):
            refuse(f"{root}: cmake --preset {options.preset} fails there; call it to see why")

    options.results.parent.mkdir(parents=True, exist_ok=True)
    with options.results.open("a") as results:
        for number, mutant in enumerate(due, 1):
            began = time.monotonic()
            verdict = known[identity(mutant)] = tree.verdict(mutant)
            seconds = round(time.monotonic() - began, 1)
            results.write(json.dumps({**mutant, "verdict": verdict, "seconds": seconds}) + "\n")
            results.flush()
            print(f"{number:3}/{len(due)} {verdict:9} {seconds:5.1f} s  "
                  f"{mutant['file']}: {mutant['from']}  ->  {mutant['to']}", flush=True)

    counts = collections.defaultdict(collections.Counter)
    for mutant in mutants:
        counts[mutant["list"]][known[identity(mutant)]] += 1
    print(f"\n{'list':14}{'mutants':>8}{'killed':>8}{'alive':>8}{'other':>8}")
    for name, count in [*counts.items(), ("all", sum(counts.values(), collections.Counter()))]:
        others = count.total() - count["killed"] - count["ALIVE"]
        print(f"{name:14}{count.total():8}{count['killed']:8}{count['ALIVE']:8}{others:8}")
    left = [m for m in mutants if known[identity(m)] != "killed"]
    for mutant in left:
        print(f"{known[identity(mutant)]}: {mutant['file']}: {mutant['from']}  ->  {mutant['to']}"
              f"  ({mutant.get('why', 'no reason given')})")
    return 1 if left else 0


if __name__ == "__main__":
    sys.exit(main())
