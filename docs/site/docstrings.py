"""Docstrings as Sphinx wants them.

In this project what follows `name :` is a description (shape, unit, meaning), no type.
"""

from __future__ import annotations

import re

UNDERLINE = re.compile(r"^\s*-{3,}\s*$")
ENTRY = re.compile(r"^(\s*)([\w*]+(?:, [\w*]+)*) : (.*)$")
NAMED = ("Parameters", "Attributes", "Returns", "Yields")
QUOTED_NAMES = ("Returns", "Yields")  # where napoleon takes a lone name for a type
QUOTED = re.compile(r"(``.*?``|`[^`]*`)")


def rewrite(lines: list[str]) -> None:
    """Move descriptions off the line of their name, and keep stars and back-ticks from being read as markup."""
    section, indent, done = "", "", []
    for number, line in enumerate(lines):
        following = lines[number + 1] if number + 1 < len(lines) else ""
        if UNDERLINE.match(following):
            section, indent = line.strip(), line[: len(line) - len(line.lstrip())]
        entry = ENTRY.match(line)
        if entry and section in NAMED and entry.group(1) == indent:
            name = f"``{entry.group(2)}``" if section in QUOTED_NAMES else entry.group(2)
            done += [f"{indent}{name}", f"{indent}    {_plain(_ended(entry.group(3), following, indent))}"]
        else:
            done.append(line if UNDERLINE.match(line) else _plain(line))
    lines[:] = done


def _ended(described: str, following: str, indent: str) -> str:
    """A description with a full stop, where a sentence follows below it: the two stand in one paragraph."""
    sentence = following.startswith(f"{indent}  ") and following.lstrip()[:1].isupper()
    return f"{described}." if sentence and described[-1:] not in ".,:;(" else described


def _plain(line: str) -> str:
    """Stars outside quotes are stars; a letter right after a quote ends it."""
    parts = QUOTED.split(line)
    for k, part in enumerate(parts):
        if k % 2 == 0:
            parts[k] = part.replace("*", r"\*")
        elif parts[k + 1][:1].isalnum():
            parts[k] = part + "\\ "
    return "".join(parts)
