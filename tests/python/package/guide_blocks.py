"""The examples of docs/python.md."""
import pathlib
import re

PAGE = pathlib.Path(__file__).parents[3] / "docs/python.md"


def examples(heading, language="python"):
    """The blocks of one section, as text."""
    section = PAGE.read_text().split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]
    return re.findall(rf"```{language}\n(.*?)```", section, re.DOTALL)
