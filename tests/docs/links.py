#!/usr/bin/env python3
"""Follows every link of every Markdown file of the source tree, and looks for every file that one names.

  tests/docs/links.py [ROOT]

A link to a file needs the file, one to a heading (#anchor, as GitHub names it) the heading. Addresses
of other sites are not asked. A `name` in a page needs a file when it begins with a folder of the tree,
ends as sources do, or stands in the first column of a README's map. It may be a path from the root or
from the page, lack its ending, be the name alone, or hold *, {a,b} and words in capitals for anything.
Exit codes: 0 all are there; 1 the others follow, one a line, as FILE:LINE.
"""

import fnmatch
import os
import re
import subprocess
import sys

LINK = re.compile(r"""!?\[(?:[^\]\[]|\[[^\]]*\])*\]\(<?([^)\s>]+)>?(?:\s+"[^"]*")?\)"""
                  r"""|(?:src|href)="([^"]+)\"""")
ELSEWHERE = re.compile(r"^[a-z][a-z0-9+.-]*:")
SOURCE = re.compile(r"\.(h|cc|proto|cmake|py|sh|yml)$")
MAP_HEADING = re.compile(r"\| (file|room|where|file or room) \|")


def files_of(root):
    """What git knows or would add; every file of a folder that is no checkout."""
    command = ["git", "ls-files", "-co", "--exclude-standard"]
    try:
        if os.path.exists(os.path.join(root, ".git")):
            listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
            return sorted(name for name in set(listed.stdout.split("\n"))
                          if name and os.path.exists(os.path.join(root, name)))
    except (subprocess.CalledProcessError, FileNotFoundError):
        pass  # no git here, or it does not trust the folder
    found = []
    for folder, folders, names in os.walk(root):
        folders[:] = [name for name in folders
                      if not name.startswith(".") and name not in ("build", "runs")]
        found += [os.path.relpath(os.path.join(folder, name), root) for name in names]
    return sorted(found)


def text_of(path):
    """The page without what stands in fenced blocks, with its line numbers."""
    fenced, lines = False, []
    with open(path, encoding="utf-8") as file:
        for line in file:
            fence = line.lstrip().startswith("```")
            lines.append("\n" if fence or fenced else line)
            fenced ^= fence
    return "".join(lines)


def anchors(path, known={}):  # noqa: B006, a cache
    if path not in known:
        known[path], times = set(), {}
        for line in text_of(path).split("\n"):
            heading = re.match(r"#{1,6}\s+(.*?)\s*#*\s*$", line)
            if heading is None:
                continue
            title = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading.group(1))
            name = re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
            known[path].add(f"{name}-{times[name]}" if name in times else name)
            times[name] = times.get(name, 0) + 1
    return known[path]


class Tree:
    """The files and folders of the source tree, to be asked for a name as a page writes it."""

    def __init__(self, files):
        self.paths = set()
        for file in files:
            self.paths |= {file, os.path.splitext(file)[0]}
            while file := os.path.dirname(file):
                self.paths.add(file)
        self.tops = {path for path in self.paths if "/" not in path and path not in files}
        self.names = {os.path.basename(path) for path in self.paths}

    def has(self, name, folder):
        name = re.sub(r"[A-Z]{2,}(?![\w.]*\.md)", "*", name.rstrip("/"))
        name = re.sub(r"\{[^}]*\}", "*", name)
        if "/" not in name:
            return bool(fnmatch.filter(self.names, name))
        places = (os.path.normpath(os.path.join(folder, name)), os.path.normpath(name))
        return any(place in self.paths or ("*" in place and fnmatch.filter(self.paths, place))
                   for place in places)


def names_of(page, text, tree):
    """(line, name) of what must be a file or folder."""
    in_map = False
    for number, line in enumerate(text.split("\n"), 1):
        if MAP_HEADING.match(line):
            in_map = page.endswith("README.md")
        elif not line.startswith("|"):
            in_map = False
        first_column = line.split("|")[1] if in_map and line.count("|") > 1 else ""
        for match in re.finditer(r"`([\w./{},*-]+)`", line):
            name = match.group(1)
            if name.endswith(".pb.h"):  # the build makes it
                continue
            if (name.split("/")[0] in tree.tops and "/" in name) or SOURCE.search(name) \
                    or match.group() in first_column:
                yield number, name


def faults(root):
    files = files_of(root)
    tree = Tree(files)
    for name in files:
        if not name.endswith(".md"):
            continue
        path = os.path.join(root, name)
        for number, file in names_of(name, text_of(path), tree):
            if not tree.has(file, os.path.dirname(name)):
                yield f"{name}:{number}: `{file}`: no such file"
        text = re.sub(r"`[^`\n]*`", lambda code: " " * len(code.group()), text_of(path))
        for match in LINK.finditer(text):
            link, number = match.group(1) or match.group(2), text.count("\n", 0, match.end()) + 1
            if ELSEWHERE.match(link):
                continue
            file, _, anchor = link.partition("#")
            target = os.path.normpath(os.path.join(os.path.dirname(path), file)) if file else path
            if not os.path.exists(target):
                yield f"{name}:{number}: {link}: no such file"
            elif anchor and (not target.endswith(".md") or anchor not in anchors(target)):
                yield f"{name}:{number}: {link}: no such heading"


def main():
    root = os.path.abspath(sys.argv[1] if len(sys.argv) > 1 else
                           os.path.join(os.path.dirname(__file__), "..", ".."))
    found = list(faults(root))
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
