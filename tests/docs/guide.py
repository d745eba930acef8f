#!/usr/bin/env python3
"""Runs the commands of a page of documentation as a reader would.

  tests/docs/guide.py PAGE.md BIN_DIR FOLDER

Every block that is fenced as ```sh runs, in the order of the page, in one bash and one empty FOLDER,
which shows the source tree by links, and the build that is tested as build/release. The programs of
BIN_DIR are first on PATH. Where the system lets it, the page has a network of its own, so that a port
of the page is free. Exit codes: 0 every command ended with 0; 1 one did not: its line of the page and
the last output follow.
"""

import os
import shutil
import signal
import subprocess
import sys

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
LINES_OF_OUTPUT = 60
TIMEOUT_S = 240
OWN_NETWORK = ["unshare", "-rn", "bash", "-c", 'ip link set lo up && exec "$@"', "own-network"]


def script_of(page):
    """The ```sh blocks as a script whose line numbers are the page's, and how many they are."""
    lines, inside, fence, blocks = [], False, None, 0
    with open(page, encoding="utf-8") as file:
        for line in file:
            text = line.strip()
            if fence is None and text.startswith("```"):
                fence, inside = "```", text[3:].split()[:1] == ["sh"]
                blocks += inside
                lines.append("")
            elif fence is not None and text == fence:
                fence, inside = None, False
                lines.append("")
            else:
                lines.append(line.rstrip("\n") if inside else "")
    name = os.path.relpath(page, ROOT)
    # The trap stands on the first line, which no block can have: a fence comes before it.
    lines[0] = (f"set -Eeuo pipefail; trap 'code=$?; echo \"{name}:$LINENO: \\\"$BASH_COMMAND\\\" "
                "ended with $code\" >&2' ERR")
    return "\n".join(lines) + "\n", blocks


def reader_folder(folder, programs):
    """Only links to the source tree and the build, so that a path of the page is the reader's."""
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder + "/build")
    os.symlink(os.path.dirname(programs), folder + "/build/release")
    for entry in os.listdir(ROOT):
        if not entry.startswith(".") and entry not in ("build", "runs"):
            os.symlink(os.path.join(ROOT, entry), os.path.join(folder, entry))


def own_network():
    try:
        trial = subprocess.run(OWN_NETWORK + ["true"], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL, check=False)
    except FileNotFoundError:
        return []
    return OWN_NETWORK if trial.returncode == 0 else []


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    page, programs, folder = map(os.path.abspath, sys.argv[1:])
    script, blocks = script_of(page)
    print(f"{os.path.relpath(page, ROOT)}: {blocks} blocks")
    if blocks == 0:
        return 0
    reader_folder(folder, programs)
    file = folder + ".sh"
    with open(file, "w", encoding="utf-8") as text:
        text.write(script)
    environment = dict(os.environ, PATH=programs + ":" + os.environ["PATH"])
    environment.setdefault("OMP_NUM_THREADS", "1")
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    log = folder + ".log"
    with open(log, "w", encoding="utf-8") as output:
        bash = subprocess.Popen(own_network() + ["bash", file], cwd=folder, env=environment,
                                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                                start_new_session=True)
        try:
            code = bash.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            code = f"no end within {TIMEOUT_S} s"
        finally:  # what the page left running
            try:
                os.killpg(bash.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            bash.wait()
    if code == 0:
        return 0
    with open(log, encoding="utf-8", errors="replace") as output:
        print("".join(output.readlines()[-LINES_OF_OUTPUT:]))
    print(f"{os.path.relpath(page, ROOT)}: {code}; the rest of the output: {log}")
    return 1


if __name__ == "__main__":
    sys.exit(main())
