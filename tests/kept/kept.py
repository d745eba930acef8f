#!/usr/bin/env python3
"""Holds what CONTRIBUTING.md promises to keep.

  kept.py wire PROTO KEPT [--write]   every line of KEPT is still in the schema: names, numbers, types
  kept.py run KEPT BIN FOLDER         the programs of BIN read a run directory of an older version,
                                      find nothing wrong, and give its table and its report again

New fields, columns and keys may come. --write adds the schema's new ones to KEPT; lines go only by hand,
with a new package version. Exit codes: 0 all is kept; 1 what is not follows, one a line.
"""

import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys

WORDS = {"environment"}  # keys of a report that say which programs wrote it


def schema_of(path):
    """The schema as lines: Message.field = NUMBER TYPE, Enum.VALUE = NUMBER, rpc Service.Method(A) B."""
    with open(path, encoding="utf-8") as file:
        text = re.sub(r"//.*", "", file.read())
    lines, scope = ["package " + re.search(r"package ([\w.]+);", text).group(1)], []
    token = re.compile(r"(message|enum|service|oneof)\s+(\w+)\s*\{|(\})|rpc\s+(\w+)\s*\(([^)]*)\)\s*returns"
                       r"\s*\(([^)]*)\)|((?:repeated |optional )?[\w.]*(?:<[^>]*>)?)\s*\b(\w+)\s*=\s*(\d+)")
    for match in token.finditer(text):
        kind, name, end, call, request, response, label, field, number = match.groups()
        if kind:
            scope.append((kind, name))
        elif end:
            if scope:
                scope.pop()
        elif call:
            lines.append(f"rpc {scope[-1][1]}.{call}({request}) {response}")
        elif scope:  # a oneof's fields are its message's
            owner = ".".join(name for kind, name in scope if kind != "oneof")
            lines.append(f"{owner}.{field} = {number} {label.strip()}".rstrip())
    return lines


def wire(proto, kept, write):
    now = schema_of(proto)
    before = []
    if os.path.exists(kept):
        with open(kept, encoding="utf-8") as file:
            before = file.read().split("\n")[:-1]
    gone = [line for line in before if line not in now]
    if write and not gone:
        with open(kept, "w", encoding="utf-8") as file:
            file.write("\n".join(now) + "\n")
    return [f"{proto}: '{line}' of {kept} is gone or changed: clients of this version have it. Keep it, or "
            "make a new package version" for line in gone]


def differences(before, now, path=""):
    """What `before` holds and `now` does not."""
    if isinstance(before, dict) and isinstance(now, dict):
        for key in before:
            if key not in WORDS:
                yield from differences(before[key], now[key], f"{path}.{key}") if key in now \
                    else [f"{path}.{key}: gone"]
    elif isinstance(before, list) and isinstance(now, list) and len(before) == len(now):
        for index, pair in enumerate(zip(before, now)):
            yield from differences(*pair, f"{path}[{index}]")
    elif isinstance(before, float) and isinstance(now, (int, float)):
        if not math.isclose(before, now, rel_tol=1e-9, abs_tol=1e-12):  # another compiler's last digits
            yield f"{path}: was {before}, is {now}"
    elif before != now:
        yield f"{path}: was {before}, is {now}"


def rows_of(path):
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def run(kept, programs, folder):
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(kept, folder)
    for file in ("table.csv", "report.json"):
        os.remove(os.path.join(folder, file))
    for command in (["robostress-store", "verify", folder], ["robostress-report", folder]):
        done = subprocess.run([os.path.join(programs, command[0]), *command[1:]], capture_output=True,
                              text=True, check=False)
        if done.returncode != 0:
            return [f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}"]
    found = list(differences(rows_of(f"{kept}/table.csv"), rows_of(f"{folder}/table.csv"), "table.csv"))
    with open(f"{kept}/report.json", encoding="utf-8") as before, \
            open(f"{folder}/report.json", encoding="utf-8") as now:
        found += differences(json.load(before), json.load(now), "report.json")
    return found


def main():
    arguments = [word for word in sys.argv[1:] if word != "--write"]
    if len(arguments) == 3 and arguments[0] == "wire":
        found = wire(*arguments[1:], "--write" in sys.argv)
    elif len(arguments) == 4 and arguments[0] == "run":
        found = run(*arguments[1:])
    else:
        sys.exit(__doc__)
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
