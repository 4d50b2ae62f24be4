"""Look at a built site in Chromium: python docs/site/browser.py FOLDER [--quick] [--shots FOLDER]

FOLDER holds the site's index.html. The command prints the weight of the first page, the other hosts that pages ask,
what axe-core finds, and the number of pages that a search finds, all from a server and from files. Each page is read in
light and dark colors, in a wide and a narrow window; with --quick, light and wide, dark and narrow. The exit status is 1
where the first page is too heavy, or where a page asks another host, scrolls sideways, fails, or keeps someone out.
It needs Chromium, playwright and axe-core, whose file GELFORM_AXE names, and says which of them is missing.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

HEAVIEST_KB = 600.0  # 1000 bytes; the first page with all that it loads, not compressed
WINDOWS_PX = ((1400, 900), (390, 844))
THEMES = ("light", "dark")
PAGES = (
    "index.html",
    "docs/tutorial.html",
    "docs/from-color-to-depth.html",
    "reference/index.html",
    "reference/path.html",
    "search.html?q=held-out",
)
FLAGS = ["--no-sandbox", "--disable-background-networking", "--no-first-run"]
PLACES = (os.environ.get("GELFORM_CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome")
CHROMIUM = next((found for name in PLACES if name and (found := shutil.which(name))), None)
AXE = Path(os.environ.get("GELFORM_AXE", "node_modules/axe-core/axe.min.js"))
FOUND = "#search-results li"  # an answer of the search
SIDEWAYS = "document.scrollingElement.scrollWidth - document.scrollingElement.clientWidth"


def missing() -> str:
    """What the command needs and this machine does not have, in words; nothing where it has all."""
    if importlib.util.find_spec("playwright") is None:
        return "no playwright: pip install playwright"
    if CHROMIUM is None:
        return "no Chromium: apt install chromium, or set GELFORM_CHROMIUM to one"
    return "" if AXE.is_file() else f"no axe-core in {AXE}: npm install axe-core, or set GELFORM_AXE"


def faults_of(
    playwright: Any,
    site: Path,
    pages: tuple[str, ...] = PAGES,
    shots: Path | None = None,
    *,
    quick: bool = False,
) -> list[str]:
    """What is wrong with a site's pages, the first of which is weighed; figures are printed."""
    wrong = []
    looks = list(zip(THEMES, WINDOWS_PX) if quick else product(THEMES, WINDOWS_PX))
    with served(site) as server:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        for page in pages:
            for theme, size in looks:
                visit = Visit(browser, server, page, theme, size)
                wrong += visit.faults(heaviest_kb=HEAVIEST_KB if page == pages[0] else None)
                if shots:
                    visit.page.screenshot(path=shots / visit.file_name(), full_page=True)
                visit.page.close()
            visit = Visit(browser, f"{site.resolve().as_uri()}/", page, THEMES[0], WINDOWS_PX[0])
            wrong += visit.faults(axe=False)  # which reads style sheets, and files may not
            visit.page.close()
        browser.close()
    return wrong


class Visit:
    """One page in a window of its own."""

    def __init__(self, browser: Any, base: str, page: str, theme: str, size: tuple[int, int]) -> None:
        self.name, self.theme, self.width, self.base = page, theme, size[0], base
        self.troubles: list[str] = []
        self.responses: list[Any] = []
        self.asked: list[str] = []
        self.page = browser.new_page(viewport={"width": size[0], "height": size[1]}, color_scheme=theme)
        self.page.on("pageerror", lambda error: self.troubles.append(str(error)))
        self.page.on(
            "console", lambda said: self.troubles.append(said.text) if said.type == "error" else None
        )
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("response", lambda response: self.responses.append(response))
        self.page.goto(base + page)
        if "?q=" in page:
            self.page.wait_for_selector(f"{FOUND}, .search-summary")

    def faults(self, *, heaviest_kb: float | None = None, axe: bool = True) -> list[str]:
        """Prints the page's figures; what is wrong with it."""
        kb = sum(len(response.body()) for response in self.responses) / 1000
        own = urlsplit(self.base)
        hosts = {host for url in self.asked if (host := urlsplit(url).netloc) != own.netloc}
        wrong = [*self.troubles, *(f"asks {host}" for host in sorted(hosts))]
        said = f"{kb:.0f} kB, other hosts: {len(hosts)}"
        if heaviest_kb is not None and kb > heaviest_kb:
            wrong.append(f"weighs {kb:.0f} kB, expected at most {heaviest_kb:.0f}")
        if (sideways := self.page.evaluate(SIDEWAYS)) > 0:
            wrong.append(f"scrolls sideways by {sideways} px")
        if "?q=" in self.name:
            answers = self.page.locator(FOUND).count()
            said += f", found: {answers} pages"
            wrong += [] if answers else ["the search finds nothing"]
        if axe:
            self.page.evaluate(AXE.read_text(encoding="utf-8"))
            violations = self.page.evaluate("axe.run({ resultTypes: ['violations'] })")["violations"]
            said += f", axe: {len(violations)}"
            wrong += [f"{one['id']}: {[node['target'] for node in one['nodes']]}" for one in violations]
        where = f"{own.scheme}, {self.theme}, {self.width} px"
        print(f"{self.name} ({where}): {said}", flush=True)
        return [f"{self.name} ({where}): {one}" for one in wrong]

    def file_name(self) -> str:
        """A picture's name, such as `docs-tutorial-light-390.png`."""
        page = self.name.partition(".html")[0].replace("/", "-")
        return f"{page}-{self.theme}-{self.width}.png"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Nothing: the figures are what one reads."""


@contextmanager
def served(site: Path) -> Iterator[str]:
    """The address of a folder on a server, which has what lies beside it too: the list of versions."""
    site = site.resolve()
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site.parent)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/{site.name}/"
    server.shutdown()
    server.server_close()


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--quick", action="store_true", help="two looks at each page, not four")
    parser.add_argument("--shots", type=Path, help="write a picture of each page here")
    asked = parser.parse_args()
    if needed := missing():
        print(f"the site was not looked at: {needed}")
        return 0
    if asked.shots:
        asked.shots.mkdir(parents=True, exist_ok=True)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        wrong = faults_of(playwright, asked.folder, shots=asked.shots, quick=asked.quick)
    print("\n".join(wrong), end="\n" if wrong else "")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
