"""What docs/site/browser.py finds on pages that are wrong on purpose, and the versions' list over http and from files."""

from pathlib import Path

import pytest

import browser
from versions import write_versions

pytestmark = pytest.mark.slow

SITE = Path(browser.__file__).parent
RIGHT = '<html lang="en"><title>x</title><link rel="icon" href="data:,"><main><h1>x</h1>{}</main></html>'
WRONG = {
    "": "",
    "<a href='x'></a>": "link-name",
    f"<!--{'x' * 600_000}-->": "weighs 600 kB",
    "<img alt='x' src='http://127.0.0.2:9/x.png'>": "asks 127.0.0.2:9",
    "<p style='width: 2000px'>x</p>": "scrolls sideways",
    "<script>throw new Error('lost')</script>": "lost",
}


@pytest.fixture
def ready(tmp_path):
    if needed := browser.missing():
        pytest.skip(needed)
    return tmp_path


@pytest.mark.parametrize(("body", "said"), WRONG.items(), ids=lambda value: value[:20])
def test_faults_of_a_page(playwright, ready, body, said, monkeypatch):
    monkeypatch.setattr(browser, "THEMES", ("light",))
    monkeypatch.setattr(browser, "WINDOWS_PX", ((390, 844),))
    (ready / "index.html").write_text(RIGHT.format(body))
    wrong = browser.faults_of(playwright, ready, ("index.html",))
    assert any(said in one for one in wrong) if said else wrong == []


def test_a_search_that_finds_nothing(playwright, ready, monkeypatch):
    monkeypatch.setattr(browser, "THEMES", ("light",))
    monkeypatch.setattr(browser, "WINDOWS_PX", ((390, 844),))
    (ready / "search.html").write_text(RIGHT.format('<p class="search-summary">none</p>'))
    wrong = browser.faults_of(playwright, ready, ("search.html?q=x",))
    assert len([one for one in wrong if "finds nothing" in one]) == 2


@pytest.mark.parametrize("how", ["http", "file"])
def test_the_list_of_versions(playwright, ready, how):
    """It keeps the page where the other version has it; else it leads to that version's first page."""
    (ready / "site.js").write_bytes((SITE / "static" / "site.js").read_bytes())
    list_of = '<details class="versions" data-version="{0}" data-page="{1}" data-root="../" hidden><ul></ul></details>'
    head = '<script>DOCUMENTATION_OPTIONS = {{}}</script><script src="../versions.js"></script><script src="{}"></script>'
    for name, page in (("0.1.0", "index"), ("0.2.0", "index"), ("0.2.0", "new")):
        (ready / name).mkdir(exist_ok=True)
        (ready / name / f"{page}.html").write_text(head.format("../site.js") + list_of.format(name, page))
    write_versions(ready)
    with browser.served(ready) as server:
        chromium = playwright.chromium.launch(executable_path=browser.CHROMIUM, args=browser.FLAGS)
        page = chromium.new_page()
        base = server if how == "http" else f"{ready.as_uri()}/"
        page.goto(f"{base}0.2.0/new.html")
        links = page.eval_on_selector_all(".versions a", "all => all.map(one => one.href)")
        assert links == [f"{base}0.2.0/new.html", f"{base}0.1.0/index.html"]
        assert page.text_content(".versions [aria-current]") == "0.2.0"
        page.goto(f"{base}index.html")
        page.wait_for_url(f"{base}0.2.0/index.html")
        chromium.close()
