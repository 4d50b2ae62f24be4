"""The page: one file that needs nothing else, the same for the same report, safe with hostile names."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from gelform.calibration.report.content import report_content
from gelform.calibration.report.page import digits, report_page
from gelform.calibration.report.record import setting_in_words

VOID = {"meta", "img", "input", "br"}
CHROMIUM = "/usr/bin/chromium"
CUT = """[...document.querySelectorAll('.scroll,section,header,table,td,p,svg text')].filter(one => {
  const box = one.getBoundingClientRect()
  return box.right > innerWidth + 1 || box.left < -1 ||
    (!one.ownerSVGElement && one.clientWidth && one.scrollWidth > one.clientWidth + 1)
}).map(one => one.tagName + ': ' + one.textContent.slice(0, 60))"""  # what is cut, or must be scrolled sideways


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
    anchors = [link[1:] for link in found.links if link.startswith("#")]
    assert len(anchors) == 10
    assert set(anchors) <= set(found.ids)
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
    main = ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")
    for name in main:
        saved = report.held_out_saved[name]
        assert f"<td>{saved:.3g}</td><td>{report.held_out[name]:.3g}</td>" in page
    for other in ("center from the", "visible rim (°)"):
        assert other not in text, "a second angle error"


def test_the_headline_is_a_verdict_and_statistics_are_below(page, content):
    verdict = content["verdict"]
    words = {"good": "Good: use it", "fair": "Fair: usable, ", "poor": "Poor: do not rely on it yet"}
    top = page.index(f"<h2>{words[verdict['level']]}")
    next_step = page.index("<strong>Next:</strong>")
    assert top < next_step < page.index('<section id="figures">')
    for section in ("models", "saved"):
        inside = page[page.index(f'<section id="{section}">') :].partition("</section>")[0]
        assert re.search(r"</h2>\s*<details><summary>.*</details>$", inside, re.DOTALL), "folded"


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
    assert not re.search(r"url\(|@import|http|//", style)
    assert style.count("{") == style.count("}")
    named, defined = (set(re.findall(form, style)) for form in (r"var\((--[\w-]+)\)", r"(--[\w-]+):"))
    assert named - {"--aspect"} <= defined  # that one is written beside each picture
    assert not re.search(r"https?://", page)
    assert len(page.encode()) < 1_000_000


@pytest.fixture
def shown(content, presses, calibration):
    """Makes the page of the shared report with other content, every run of white space one space."""
    return lambda **other: " ".join(report_page({**content, **other}, presses, calibration).split())


def test_figures_stand_with_their_intervals_and_one_that_does_not_exist_is_a_dash(content, shown):
    assert [digits(v) for v in (2.0, 19.0, 0.5, 123.4)] == ["2.00", "19.0", "0.500", "123"]
    drawn, one = shown(), content["figures"]["normal_free_deg"]
    value, low, high = (digits(v) for v in (one["value"], *one["interval"]))
    assert f"<b>{value}° <small>{low} – {high}" in drawn
    assert drawn.count('<td class="text"><span class="tag') == len(content["checks"])
    figures = {name: one for name, one in content["figures"].items() if name != "off_contact_um"}
    assert "no press leaves enough of the image free" not in drawn
    assert "no press leaves enough of the image free" in shown(figures=figures)


def test_circles_are_in_image_pixels_and_rejected_presses_come_first_with_their_reasons(
    content, shown, presses, calibration
):
    drawn, row = shown(), content["presses"][0]
    circle = (row["center_x_px"], row["center_y_px"], row["contact_radius_px"])
    assert 'cx="{:.2f}" cy="{:.2f}" r="{:.2f}"'.format(*circle) in drawn
    assert drawn.count("<label") == len(content["presses"])
    assert "Left out" not in drawn
    rows = [dict(row) for row in content["presses"]]
    rows[0]["errors"] = {**rows[0]["errors"], "normal_free_deg": 90.0, "off_contact_um": float("nan")}
    rows[-1] |= {"accepted": False, "reason": "not a ball <b>", "errors": None}
    bare = replace(calibration, report=replace(calibration.report, samples=()))
    drawn = " ".join(report_page({**content, "presses": rows}, presses, bare).split())
    assert "<figcaption>" not in drawn, "no depth of what was not held out"
    assert "Left out: 1" in drawn
    assert "not a ball &lt;b&gt;" in drawn
    assert drawn.index("not a ball") < drawn.index("Used:")
    assert drawn.count('class="press worse"') >= 1
    assert "depth off contact – · circle" in drawn


def test_one_model_or_several(content, shown):
    rows = [
        {"candidate": "b step 3e-05", "slope_error": 0.0213, "normal_free_deg": 1.5, "chosen": True},
        {"candidate": "a <1>", "slope_error": 0.0345, "normal_free_deg": 2.0, "chosen": False},
    ]
    drawn = shown(candidates=rows)
    for text in (
        "a &lt;1&gt;",
        "<td>1.5</td><td>0.0213</td>",
        "<td>2</td><td>0.0345</td>",
        "smallest typical slope error",
    ):
        assert text in drawn
    assert '<tr class="chosen"><td>b step 3e-05 ← chosen' in drawn
    assert "Only one model was tried" in shown(candidates=rows[:1])
    assert "decides" not in shown(candidates=rows[:1])


def test_places_to_press_are_said_in_words(content, shown):
    place = {"name": "top left", "x_px": 10, "y_px": 20, "contact_radius_px": 9.0}
    drawn = shown(
        coverage={**content["coverage"], "next": [place]},
        calibration={**content["calibration"], "mm_per_px": 0.1},
    )
    assert "<ol> <li>top left: (10, 20) px, 1.0 mm from the left, 2.0 mm from the top</li> </ol>" in drawn


def test_the_learning_sentence_is_there_or_why_not(content, shown):
    assert content["learning"]["sentence"] in shown()
    assert "There is no learning curve" in shown(learning=None)


WHERE = {
    "contact_radius_ratio": 0.84,
    "contact": {
        "normal_deg": 2.12,
        "by_slope": [
            {"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 1.11, "gain": 1.02, "pixels": 500},
            {"slope_from": 0.7, "slope_to": 0.8, "normal_deg": 4.44, "gain": 0.91, "pixels": 90},
        ],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [1.0, 2.0, None, 3.0], "pixels": [99, 99, 0, 99]},
    },
    "rim": {
        "normal_deg": 3.36,
        "by_slope": [{"slope_from": 0.1, "slope_to": 0.2, "normal_deg": 1.99, "gain": 1.01, "pixels": 600}],
        "by_place": {"rows": 2, "columns": 2, "normal_deg": [1.5, 2.6, 7.0, None], "pixels": [99, 99, 70, 5]},
    },
}


def test_slopes_and_places_stand_in_their_rows_and_a_missing_bin_is_a_dash(shown):
    page = shown(where=WHERE)
    for said in (
        "edge, at 0.84 of the visible radius",
        "<td>0.1 – 0.2</td><td>1.11°</td><td>500</td>",
        "<td>0.7 – 0.8</td><td>4.44°</td><td>90</td>",
        "<tr><td>1.00°</td><td>2.00°</td></tr>",
        "<tr><td>–</td><td>3.00°</td></tr>",
    ):
        assert said in page
    for other in ("2.12°", "3.36°", "1.99°", "1.02"):
        assert other not in page, "a second angle error, or a second slope gain"


def test_every_held_out_press_has_its_depth_picture(content, shown):
    held_out = [f"{row['errors']['cap_free_um']:.0f}" for row in content["presses"] if row["errors"]]
    assert re.findall(r"<figcaption>(\d+) µm", shown()) == held_out


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (0.8500000000000001, "0.85"),
        (3e-4, "0.0003"),
        ([1.2345678, 0.98765432], "1.235 / 0.9877"),
        ((3, 2, 0), "3 / 2 / 0"),
        ({"exposure": 33.33333333, "led": "on"}, "exposure: 33.33, led: on"),
        ({}, "none"),
        (None, "none"),
        ("0123456789abcdef" * 4, "0123456789…"),
        (True, "True"),
        ("three-edges", "three-edges"),
    ],
)
def test_settings_are_said_for_people(value, said):
    assert setting_in_words(value) == said


@pytest.mark.slow
@pytest.mark.skipif(not Path(CHROMIUM).is_file(), reason=f"no chromium at {CHROMIUM}")
def test_a_real_browser_shows_it_without_a_word_or_a_request(page, playwright, tmp_path):
    """Light, dark and narrow: no console message, no request, no sideways scrolling; a press opens and closes."""
    path = tmp_path / "report.html"
    path.write_text(page, encoding="utf-8")
    browser = playwright.chromium.launch(executable_path=CHROMIUM)
    tab, said, asked = browser.new_page(), [], []
    tab.on("console", lambda message: said.append(message.text))
    tab.on("request", lambda request: asked.append(request.url))
    tab.goto(path.as_uri())
    for width, scheme in ((1200, "light"), (1200, "dark"), (390, "light"), (380, "light")):
        tab.set_viewport_size({"width": width, "height": 800})
        tab.emulate_media(color_scheme=scheme)
        tab.evaluate("document.querySelectorAll('details').forEach(one => one.open = true)")
        assert tab.evaluate(CUT) == [], width
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        press = tab.locator("label.press").first
        small = press.locator("svg").bounding_box()["width"]
        press.click()
        assert press.locator("svg").bounding_box()["width"] > 1.5 * small
        press.click()
        assert press.locator("svg").bounding_box()["width"] == small
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    tab.emulate_media(media="print", color_scheme="dark")
    assert tab.evaluate("getComputedStyle(document.body).color") == "rgb(0, 0, 0)"
    assert min(backgrounds_behind_text(tab)) > 150, (
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
