"""What the theme's pages lack for readers who listen to them or use a keyboard, and for those with a small screen."""

from __future__ import annotations

import re
from pathlib import Path

PICTURE = re.compile(r'(<a [^>]*>\s*|<picture>(?:\s*<source[^>]*>)*\s*)?(<img [^>]*src="([^":]+)"[^>]*/?>)')
CHANGES = {  # in a page of the theme, and what stands there instead
    '<p class="caption" role="heading">': '<p class="caption" role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Site">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="This page">',
}
HEADING_OF_SEARCH = '<h1 class="only-read">Search</h1>'
RESULTS = '<div id="search-results">'


def finish(folder: Path) -> None:
    """Change all pages of a site; a change that fits no page is an error, since the theme has changed."""
    unused = {*CHANGES, RESULTS, '<article role="main"'}
    for path in folder.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        unused -= {old for old in unused if old in text}
        for old, new in CHANGES.items():
            text = text.replace(old, new)
        text = text.replace(RESULTS, HEADING_OF_SEARCH + RESULTS)
        if path.parent.name == "zh":
            text = text.replace('<article role="main"', '<article role="main" lang="zh"')
        path.write_text(opening_pictures(text), encoding="utf-8")
    if unused:
        raise SystemExit(
            f"Expected on some page of the theme what {__file__} changes, did not find {unused}."
        )


def opening_pictures(text: str) -> str:
    """A page whose pictures lead to their files, where a small screen can enlarge them."""

    def linked(match: re.Match[str]) -> str:
        return match.group(0) if match.group(1) else f'<a href="{match.group(3)}">{match.group(2)}</a>'

    return PICTURE.sub(linked, text)
