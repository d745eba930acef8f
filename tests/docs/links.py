#!/usr/bin/env python3
"""Follows every link of every Markdown file of the source tree.

  tests/docs/links.py [ROOT]

A link to a file needs the file, one to a heading (#anchor, as GitHub names it) the heading. Addresses
of other sites are not asked. Exit codes: 0 all are there; 1 the others follow, one a line, as FILE:LINE.
"""

import os
import re
import subprocess
import sys

LINK = re.compile(r"""!?\[(?:[^\]\[]|\[[^\]]*\])*\]\(<?([^)\s>]+)>?(?:\s+"[^"]*")?\)"""
                  r"""|(?:src|href)="([^"]+)\"""")
ELSEWHERE = re.compile(r"^[a-z][a-z0-9+.-]*:")


def pages(root):
    """What git knows or would add; every .md of a folder that is no checkout."""
    command = ["git", "ls-files", "-co", "--exclude-standard", "*.md"]
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
        found += [os.path.relpath(os.path.join(folder, name), root)
                  for name in names if name.endswith(".md")]
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


def faults(root):
    for name in pages(root):
        path = os.path.join(root, name)
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
