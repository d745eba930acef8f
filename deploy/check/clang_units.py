"""What clang needs to read a unit of a build that GCC compiles: its arguments, and precompiled headers of its own."""

import json
import os
import re
import shlex
import subprocess
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
FIRST = os.path.join(ROOT, "deploy", "check", "clang_first.h")
COMPILER = re.compile(r"(^|/)(c\+\+|g\+\+|clang\+\+)(-\d+)?$")


def missing(message):
    """Ends the program: it cannot begin."""
    print(f"{os.path.basename(sys.argv[0])}: {message}", file=sys.stderr)
    sys.exit(2)


def arguments(entry, unit):
    """Clang's arguments of an entry of compile_commands.json, and the precompiled header that it names, or None."""
    words = iter(shlex.split(entry["command"]))
    for word in words:
        if COMPILER.search(word):
            break  # a launcher (ccache) and its settings stand before it
    kept, header = [], None
    for word in words:
        if word in ("-o", "-MF", "-MT", "-MQ"):
            next(words)
        elif word == "-include":
            value = next(words)
            if os.path.basename(value).startswith("cmake_pch"):
                header = value
            else:
                kept += [word, value]
        elif word not in ("-c", "-MD", unit, entry["file"]) and not word.startswith(("-W", "-O")):
            kept.append(word)
    return kept, header


def units(build):
    """(file, clang's arguments, precompiled header or None) of every unit; generated code is left out."""
    path = os.path.join(build, "compile_commands.json")
    try:
        with open(path, encoding="utf-8") as file:
            entries = json.load(file)
    except (OSError, ValueError) as error:
        missing(f"{path}: {error}; configure the build: cmake --preset {os.path.basename(build)}")
    found = {}
    for entry in entries:
        unit = os.path.normpath(os.path.join(entry["directory"], entry["file"]))
        generated = os.path.join(build, "generated") + os.sep
        if "cmake_pch" not in os.path.basename(unit) and not unit.startswith(generated):
            found.setdefault(unit, arguments(entry, unit))
    # A folder that was moved or mounted elsewhere: its units would be no file of this tree, and none be read.
    if found and not any(unit.startswith((ROOT + os.sep, build + os.sep)) for unit in found):
        missing(f"{path}: its sources are elsewhere ({next(iter(found))}), not in {ROOT}; remove {build} and "
                "configure it here")
    return [(unit, *rest) for unit, rest in found.items()]


class PrecompiledHeaders:
    """Clang's own form of the precompiled headers of a build, in FOLDER."""

    def __init__(self, folder):
        os.makedirs(folder, exist_ok=True)
        self._folder, self._made = folder, {}

    def make(self, chosen):
        """Those that the units CHOSEN name; returns how many they are."""
        for _, flags, header in chosen:
            if header is not None and header not in self._made:
                target = os.path.join(self._folder, os.path.basename(os.path.dirname(header)) + ".pch")
                done = subprocess.run(["clang++", *flags, "-Wno-everything", "-include", FIRST, "-x", "c++-header",
                                       header, "-o", target], capture_output=True, text=True, check=False)
                if done.returncode:
                    missing(f"{header}: clang cannot compile it:\n{done.stderr}")
                self._made[header] = target
        return len(self._made)

    def flags(self, unit, header):
        if unit.endswith(".c"):  # none of it is C
            return []
        return ["-include", FIRST] if header is None else ["-include-pch", self._made[header]]
