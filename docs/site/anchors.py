"""Links and loads of a built site that lead nowhere: to a page or a file that is not there, or to no place on a page."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LEADING = {"a": "href", "img": "src", "source": "srcset", "script": "src", "link": "href"}
OWN_FOLDERS = ("_static", "_sources")  # of the theme


class _Page(HTMLParser):
    """Collects where a page's links lead, and the places that others may lead to."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Look at one element."""
        given = {name: value for name, value in attrs if value}
        self.places |= {given[name] for name in ("id", "name") if name in given}
        if LEADING.get(tag) in given:
            self.links.append(given[LEADING[tag]])


def broken_links(folder: Path) -> list[str]:
    """`page: link` of each link inside a site whose file, or whose place on a page, is not there."""
    pages = {path.resolve(): _read(path) for path in _pages(folder)}
    broken = []
    for path, page in pages.items():
        for link in dict.fromkeys(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            place = unquote(parts.fragment)
            lost = place and target in pages and place not in pages[target].places
            if lost or not target.exists():
                broken.append(f"{path.relative_to(folder.resolve())}: {link}")
    return broken


def counted(folder: Path) -> str:
    """How many pages and links a site has, in words."""
    pages = [_read(path) for path in _pages(folder)]
    links = [urlsplit(link) for page in pages for link in page.links]
    followed = [link for link in links if not (link.scheme or link.netloc)]
    places = sum(bool(link.fragment) for link in followed)
    hosts = {link.netloc for link in links} - {""}
    outside = f"{len(links) - len(followed)} to other sites ({len(hosts)} hosts)"
    return f"{len(pages)} pages, {len(followed)} links within them, {places} to a place on a page; {outside}, not followed"


def _pages(folder: Path) -> list[Path]:
    inside = sorted(folder.rglob("*.html"))
    return [path for path in inside if path.relative_to(folder).parts[0] not in OWN_FOLDERS]


def _read(path: Path) -> _Page:
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page
