"""What a built page would load from elsewhere than its own folder. Links that a reader follows are no loads."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

LOADING = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
URL_OF_CSS = re.compile(r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^\"')\s]+)")
PASSIVE = {
    "canonical",
    "next",
    "prev",
    "search",
    "index",
    "author",
}  # <link rel=...> that browsers do not fetch


class _Loads(HTMLParser):
    """Collects the addresses that a page loads from other hosts."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look at one element."""
        given = dict(attrs)
        address = given.get(LOADING.get(tag, "")) or ""
        if re.match(r"(https?:)?//", address) and given.get("rel") not in PASSIVE:
            self.found.append(address)


def requests_to_outside(folder: Path) -> list[str]:
    """`page: address` of each load from another host, in a site's pages, styles and scripts."""
    found = []
    for page in sorted(folder.rglob("*")):
        if page.suffix == ".html":
            loads = _Loads()
            loads.feed(page.read_text(encoding="utf-8"))
            found += [f"{page.name}: {address}" for address in loads.found]
        if page.suffix in (".html", ".css"):
            found += [f"{page.name}: {a}" for a in URL_OF_CSS.findall(page.read_text(encoding="utf-8"))]
    return found
