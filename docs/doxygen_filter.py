#!/usr/bin/env python3
"""Shows Doxygen the comments of a header: doxygen_filter.py FILE writes it with // as /// or ///<.

The sources keep plain comments. One that stands right above a declaration documents it, one behind a
member documents that member. Lines that are laid out in columns (formulas, tables of symbols) stay as
they are laid out.
"""

import re
import sys

OWN_LINE = re.compile(r"^(\s*)//(?!/)\s?(.*)$")
BEHIND = re.compile(r"^(\s*[^\s/#}].*?[;,]|\s*k[A-Z]\w*(?: = [^,]+)?)(\s+)//\s?(.*)$")
LAID_OUT = re.compile(r'^ {2}|^[^"].* {2,}\S')
DIRECTIVE = re.compile(r"^\s*(clang-format|NOLINT)")


def behind(line):
    """The match of a comment behind a member, where // is not part of a string."""
    match = BEHIND.match(line)
    return match if match and match.group(1).count('"') % 2 == 0 else None


def block_of(texts, indent):
    """The lines of one comment; what is laid out in columns becomes a code block."""
    lines, code = [], False
    for index, text in enumerate(texts):
        following = next((t for t in texts[index:] if t.strip()), "")
        if bool(LAID_OUT.search(text)) != code and (text.strip() or not LAID_OUT.search(following)):
            lines.append("~~~")
            code = not code
        lines.append(text)
    if code:
        lines.append("~~~")
    return [f"{indent}/// {line}".rstrip() for line in lines]


def filtered(lines):
    out, index = [], 0
    while index < len(lines):
        own, tail = OWN_LINE.match(lines[index]), behind(lines[index])
        if tail:
            out.append(f"{tail.group(1)}{tail.group(2)}///< {tail.group(3)}")
            column = tail.end(2)
            while index + 1 < len(lines):  # the comment goes on in the same column
                more = OWN_LINE.match(lines[index + 1])
                if not more or len(more.group(1)) != column or column < 8:
                    break
                out.append(f"{more.group(1)}///< {more.group(2)}")
                index += 1
        elif own and not DIRECTIVE.match(own.group(2)):
            texts = []
            while index < len(lines) and (more := OWN_LINE.match(lines[index])):
                texts.append(more.group(2))
                index += 1
            alone = index == len(lines) or not lines[index].strip()  # documents nothing below it
            out += [f"{own.group(1)}// {text}" for text in texts] if alone \
                else block_of(texts, own.group(1))
            continue
        else:
            out.append(lines[index])
        index += 1
    return out


SCHEMA = [(r"^package (\w+)\.(\w+);", r"namespace \1 { namespace \2 {"),
          (r"^(\s*)(?:message|service) (\w+) \{", r"\1struct \2 {"), (r"^(\s*)oneof (\w+) \{", r"\1union {"),
          (r"^(\s*)rpc (\w+)\((.*?)\) returns \((.*?)\)", r"\1\4 \2(\3)"),
          (r"\b(stream|repeated|optional) ([\w.]+)", r"\1<\2>"), (r"^(\s*[^/]*\w) = \d+;", r"\1;"),
          (r"\}$", "};"), (r"^(syntax|import|option).*", "")]


def as_cpp(lines):
    """The lines of a .proto file as C++."""
    out, in_enum = [], False
    for line in lines:
        in_enum = (in_enum or line.lstrip().startswith("enum ")) and "}" not in line
        if in_enum:
            line = re.sub(r"(= \d+);", r"\1,", line)
        elif not line.lstrip().startswith("//"):
            for pattern, cpp in SCHEMA:
                line = re.sub(pattern, cpp, line)
        out.append(line)
    return out + ["} }"]


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as file:
        text = file.read().rstrip("\n").split("\n")
    print("\n".join(filtered(as_cpp(text) if sys.argv[1].endswith(".proto") else text)))
