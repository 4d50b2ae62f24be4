"""Links of the repository's Markdown that mean something else on the site, and those that lead to no file."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import gelform

ROOT = Path(__file__).resolve().parents[2]
BLOCK = re.compile(r"^( *```.*?^ *```)", re.MULTILINE | re.DOTALL)
TARGET = re.compile(r"\[([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
INDEXED = ("docs/decisions", "examples")  # folders that have a page


def links_of_the_site(text: str, page: Path, warn: Callable[[str], None], root: Path = ROOT) -> str:
    """A page whose links to functions lead to their reference, to examples to their pages; others off the site are text.

    Parameters
    ----------
    text, page : a page in Markdown and its file
    warn : is told each link whose file is not there, or whose source file does not define the name
    root : folder of the repository
    """

    def kept(match: re.Match[str]) -> str:
        words, target, anchor = match[1], match[2], match[3] or ""
        if re.match(r"\w+:", target):
            return match[0]
        path = (page.parent / target).resolve()
        if not path.exists():
            warn(f"{page.relative_to(root)}: a link leads nowhere: {target}")
            return words
        place, name = path.relative_to(root).as_posix(), words.strip("`")
        if place.startswith("src/gelform/") and path.suffix == ".py" and words == f"`{name}`":
            if not re.search(rf"^((def|class) {name}\b|{name}\b.*=)", path.read_text("utf-8"), re.MULTILINE):
                warn(f"{page.relative_to(root)}: {target} defines no {name}")
            return f"{{py:obj}}`{name} <gelform.{name}>`" if name in gelform.__all__ else words
        if place in INDEXED:
            return f"[{words}]({target}/index.md)"
        if place.startswith("examples/"):
            return f"[{words}]({target.removesuffix('.py')}.md)"
        on_the_site = path.suffix in (".md", ".png", ".jpg", ".webp") and not place.startswith((".", "paper"))
        return f"[{words}]({target}{anchor})" if on_the_site else words

    parts = BLOCK.split(text)  # every second one is a block of code
    return "".join(part if k % 2 else TARGET.sub(kept, part) for k, part in enumerate(parts))
