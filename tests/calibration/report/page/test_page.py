"""The page: one file that needs nothing else, the same for the same report, safe with hostile names."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from gelform.calibration.report.content import report_content
from gelform.calibration.report.page.page import NAV, report_page

VOID = {"meta", "img", "input", "br"}
CHROMIUM = "/usr/bin/chromium"


class Page(HTMLParser):
    """Tags, attributes and text; fails where a tag is closed that was not opened."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.links, self.ids, self.text = [], [], [], [], ""
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        found = dict(attrs)
        self.links += [found[name] for name in ("src", "href", "data", "action", "poster") if name in found]
        self.ids += [found["id"]] if "id" in found else []
        assert not any(name.startswith("on") for name in found)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_sections_are_where_the_links_lead(page):
    found = Page(page)
    assert {link[1:] for link in found.links if link.startswith("#")} == {anchor for anchor, _ in NAV}
    assert {anchor for anchor, _ in NAV} <= set(found.ids)
    assert len(found.ids) == len(set(found.ids))


def test_it_says_the_figures_of_the_json_and_whose_they_are(page, content, calibration):
    text, again, report = Page(page).text, json.loads(json.dumps(content)), calibration.report
    figures = [
        again["figures"][name]["value"] for name in ("normal_free_deg", "radius_percent", "cap_free_um")
    ]
    said = [again["verdict"]["headline"], again["verdict"]["next"], again["learning"]["sentence"]]
    said += [again["calibration"]["digest"], *(f"{value:#.3g}".removesuffix(".") for value in figures)]
    for row in again["candidates"]:
        said += [row["candidate"], f"{row['normal_free_deg']:.3g}"]
    assert [one for one in said if one not in text] == []
    assert report.held_out_saved
    for name, saved in report.held_out_saved.items():
        assert f"<td>{saved:.3g}</td><td>{report.held_out[name]:.3g}</td>" in page


def test_the_same_report_is_the_same_page(page, presses, calibration, learning):
    content = report_content(presses, calibration, rng=np.random.default_rng(0), learning=learning)
    assert report_page(content, presses, calibration) == page


def test_hostile_names_stay_text(presses, calibration):
    evil = '"><script>alert(1)</script><img src=x onerror=alert(2)>'
    report = calibration.report
    rows = tuple(
        replace(row, name=f"{k}{evil}", reason=evil if k == 0 else row.reason)
        for k, row in enumerate(report.presses)
    )
    rows = (replace(rows[0], accepted=False, errors=None), *rows[1:])
    noted = replace(report, presses=rows, notes=(evil,), samples=report.samples[1:])
    renamed = replace(presses, presses=tuple(replace(p, name=r.name) for p, r in zip(presses.presses, rows)))
    hostile = replace(calibration, report=noted, sensor_name=evil, serial=evil, gel_id=evil)
    content = report_content(renamed, hostile, rng=np.random.default_rng(0))
    content["candidates"][0]["candidate"] = evil
    page = report_page(content, renamed, hostile)
    found = Page(page)
    assert "script" not in found.tags
    assert found.tags.count("img") == 1 + len(noted.samples)
    assert found.text.count("<script>") >= len(rows)


def test_it_parses_is_small_and_needs_nothing_from_outside(page):
    found = Page(page)
    assert all(link.startswith(("data:image/", "#")) for link in found.links)
    assert not {"script", "link", "iframe", "object", "form"} & set(found.tags)
    style = page[page.index("<style>") : page.index("</style>")]
    assert not re.search(r"url\(|@import|http", style)
    assert not re.search(r"https?://", page)
    assert len(page.encode()) < 1_000_000


@pytest.mark.slow
@pytest.mark.skipif(not Path(CHROMIUM).is_file(), reason=f"no chromium at {CHROMIUM}")
def test_a_real_browser_shows_it_without_a_word_or_a_request(page, playwright, tmp_path):
    """Light, dark and narrow: no console message, no request, no sideways scrolling; a press opens and closes."""
    path = tmp_path / "report.html"
    path.write_text(page, encoding="utf-8")
    browser = playwright.chromium.launch(executable_path=CHROMIUM)
    for width, scheme in ((1200, "light"), (1200, "dark"), (380, "light")):
        tab = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
        said, asked = [], []
        tab.on("console", lambda message, said=said: said.append(message.text))
        tab.on("request", lambda request, asked=asked: asked.append(request.url))
        tab.goto(path.as_uri())
        assert said == []
        assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        press = tab.locator("label.press").first
        small = press.locator("svg").bounding_box()["width"]
        press.click()
        assert press.locator("svg").bounding_box()["width"] > 1.5 * small
        press.click()
        assert press.locator("svg").bounding_box()["width"] == small
        tab.close()
    paper = browser.new_page(color_scheme="dark")
    paper.goto(path.as_uri())
    paper.emulate_media(media="print", color_scheme="dark")
    assert paper.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
    assert min(backgrounds_behind_text(paper)) > 150, (
        "dark ink on a dark ground: it was printed from a dark screen"
    )
    browser.close()


def backgrounds_behind_text(tab):
    """Darkest channel of every ground that is painted behind text, 0-255."""
    colors = tab.evaluate(
        "[...document.querySelectorAll('section,.tag,td,body')].map(e => getComputedStyle(e).backgroundColor)"
    )
    painted = [re.findall(r"[\d.]+", color) for color in colors]
    return [min(float(v) for v in one[:3]) for one in painted if len(one) == 3]
