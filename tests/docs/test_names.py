#!/usr/bin/env python3
"""Whether the tests that the pages name are there: test_names.py ROOT BUILD.

Each alternative of a pattern behind -R must match a test of the build folder BUILD, each
build/PRESET/bin/NAME, test_bin/NAME and target behind `ninja -C` be made by it. Exit codes: 0 all do; 1 the others follow, one a line, as FILE:LINE.
"""

import os
import re
import subprocess
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import links  # noqa: E402, beside this file

PATTERN = re.compile(r"""-R\s+(?:'([^']+)'|"([^"]+)"|([\w^$.|-]+))""")
ELSEWHERE = ("fuzzer",)  # tests of another preset


def tests_of(build):
    listed = subprocess.run(["ctest", "--test-dir", build, "-N"], capture_output=True, text=True,
                            check=True)
    return re.findall(r"^ *Test +#\d+: (\S+)", listed.stdout, re.M)


def made_by(build):
    """What the build makes, as bin/NAME, test_bin/NAME and TARGET."""
    names = set()
    for folder in ("bin", "test_bin"):
        if os.path.isdir(os.path.join(build, folder)):
            names |= {f"{folder}/{name}" for name in os.listdir(os.path.join(build, folder))}
    if os.path.exists(os.path.join(build, "build.ninja")):
        with open(os.path.join(build, "build.ninja"), encoding="utf-8") as file:
            names |= set(re.findall(r"^build ([\w./-]+)(?= |:)", file.read(), re.M))
    return names


def programs_in(text):
    """(where it stands, name) of what a page takes from a build."""
    for match in re.finditer(r"\b(?:build/(?:release|asan|tsan)/(bin/[\w-]+)|(test_bin/\w+))", text):
        yield match.start(), match.group(1) or match.group(2)
    for match in re.finditer(r"ninja -C \S+((?: \w+)+)", text):
        for target in match.group(1).split():
            yield match.start(), target


def alternatives(pattern):
    """`^(a|b)_test$` as `^a_test$`, `^b_test$`; `a|b` as `a`, `b`."""
    group = re.fullmatch(r"([^()|]*)\(([^()]*)\)([^()|]*)", pattern)
    before, middle, after = group.groups() if group else ("", pattern, "")
    return [(part, before + part + after) for part in middle.split("|")]


def faults(root, build):
    tests, made = tests_of(build), made_by(build)
    for page in links.files_of(root):
        if not page.endswith(".md"):
            continue
        with open(os.path.join(root, page), encoding="utf-8") as file:
            text = file.read()
        for match in PATTERN.finditer(text):
            pattern, line = next(filter(None, match.groups())), text.count("\n", 0, match.start()) + 1
            for part, expression in alternatives(pattern):
                if part not in ELSEWHERE and not any(re.search(expression, test) for test in tests):
                    yield f"{page}:{line}: ctest -R '{pattern}': no test's name matches '{part}'"
        for start, name in programs_in(text):
            if name not in made:
                yield f"{page}:{text.count(chr(10), 0, start) + 1}: {name}: the build does not make it"


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    found = list(faults(*map(os.path.abspath, sys.argv[1:])))
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
