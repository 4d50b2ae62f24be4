"""Links of the repository's Markdown that mean something else on the site."""

from __future__ import annotations

import re
from pathlib import Path

import gelform

FUNCTION = re.compile(r"\[`(\w+)`\]\([^)]*/src/gelform/[^)]*\.py\)")
INDEXED = ("docs/decisions", "examples")  # folders that have a page
SHOWN = (".md", ".png", ".jpg", ".svg", ".webp", ".gif")  # files that the site has
TARGET = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def linked_to_the_reference(text: str) -> str:
    """``[`name`](.../src/gelform/file.py)`` leads to the reference of a public name instead."""

    def reference(match: re.Match[str]) -> str:
        name = match.group(1)
        return f"{{py:obj}}`{name} <gelform.{name}>`" if name in gelform.__all__ else f"`{name}`"

    return FUNCTION.sub(reference, text)


def without_files_off_the_site(text: str, page: Path, root: Path) -> str:
    """Links to what is no page become their text; those to examples lead to their pages."""

    def kept(match: re.Match[str]) -> str:
        words, target, anchor = match.group(1), match.group(2), match.group(3) or ""
        if "://" in target or target.startswith("mailto:"):
            return match.group(0)
        path = (page.parent / target).resolve()
        relative = path.relative_to(root) if path.is_relative_to(root) else path
        if relative.as_posix() in INDEXED:
            return f"[{words}]({target}/index.md)"
        if relative.parts[0] == "examples" and path.suffix == ".py":
            return f"[{words}]({target.removesuffix('.py')}.md)"
        if relative.parts[:2] == ("src", "gelform") or path.suffix in SHOWN:
            return f"[{words}]({target}{anchor})"
        return words

    return TARGET.sub(kept, text)
