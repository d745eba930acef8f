#!/usr/bin/env python3
"""Breaks lines on purpose and asks the tests whether they notice.

  tests/mutants/mutants.py tests/mutants/arm.txt [--only TEXT] [--build build/release]

A list has one mutant per block of lines, blocks apart by an empty line:

  file: robot_client/control/command_limiter.cc
  from: axis.upper = arm.upper[i] - margin;
  to:   axis.upper = arm.upper[i] - margin + 0.05;
  test: robot_client_control_test

`from` stands once in its file. The file is changed in place, the test's program built and run, and
the file put back, also after Ctrl-C. Prints a line per mutant: killed (a test fails), ALIVE, or no
mutant (it does not compile). Exit code 1 where one is not killed, 2 for a list that does not fit the
sources.
"""
import argparse
import pathlib
import subprocess
import sys
import time


def blocks(path):
    for block in path.read_text().split("\n\n"):
        fields = {}
        for line in block.splitlines():
            if not line.strip() or line.startswith("#"):
                continue
            key, _, value = line.partition(":")
            fields[key.strip()] = value.strip()
        if fields:
            missing = {"file", "from", "to", "test"} - fields.keys()
            if missing:
                sys.exit(f"{path}: a block has no {', '.join(sorted(missing))}: {fields}")
            yield fields


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("list", type=pathlib.Path)
    parser.add_argument("--build", default="build/release")
    parser.add_argument("--only", default="", help="mutants whose file or line contains this")
    options = parser.parse_args()
    mutants = [m for m in blocks(options.list) if options.only in m["file"] + m["from"] + m["to"]]
    for mutant in mutants:
        found = pathlib.Path(mutant["file"]).read_text().count(mutant["from"])
        if found != 1:
            print(f"{options.list}: '{mutant['from']}' stands {found} times in {mutant['file']}")
            return 2
    alive = 0
    for number, mutant in enumerate(mutants, 1):
        path = pathlib.Path(mutant["file"])
        original = path.read_text()
        began = time.monotonic()
        try:
            path.write_text(original.replace(mutant["from"], mutant["to"]))
            built = subprocess.run(["ninja", "-C", options.build, mutant["test"]],
                                   capture_output=True).returncode == 0
            passed = False
            if built:
                program = pathlib.Path(options.build, "test_bin", mutant["test"])
                try:
                    passed = subprocess.run([program], capture_output=True,
                                            timeout=300).returncode == 0
                except subprocess.TimeoutExpired:
                    pass
        finally:
            path.write_text(original)
        alive += passed or not built
        verdict = "ALIVE" if passed else "killed" if built else "no mutant"
        print(f"{number:3}/{len(mutants)} {verdict:9} {time.monotonic() - began:5.1f} s  "
              f"{mutant['file']}: {mutant['from']}  ->  {mutant['to']}", flush=True)
    print(f"{len(mutants) - alive} of {len(mutants)} killed")
    return 1 if alive else 0


if __name__ == "__main__":
    sys.exit(main())
