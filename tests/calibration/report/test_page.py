"""The page: one file that needs nothing else, the same for the same report, safe with hostile names.

In its charts, a point lies where its value says, every text is escaped, and each SVG is well formed.
"""

import base64
import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.calibration.report.charts import Axes, bar_of, scale_of_errors
from gelform.calibration.report.content import report_content
from gelform.calibration.report.page import (
    HIGH,
    LOW,
    WIDTHS_PX,
    cap_scale_um,
    cap_url,
    digits,
    jpeg_url,
    press_urls,
    report_page,
    short_names,
    templates,
)
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

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_it_says_the_figures_of_the_json_and_whose_they_are(page, content, calibration):
    text, again, report = Page(page).text, json.loads(json.dumps(content)), calibration.report
    main = ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")
    said = [again["verdict"]["headline"], again["verdict"]["next"], again["learning"]["sentence"]]
    said += [again["calibration"]["digest"], *(digits(again["figures"][name]["value"]) for name in main[:3])]
    for row in again["candidates"]:
        said += [row["candidate"], f"{row['normal_free_deg']:.3g}"]
    assert [one for one in said if one not in text] == []
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
    first, *rows = [replace(row, name=f"{k}{evil}") for k, row in enumerate(report.presses)]
    rows = (replace(first, reason=evil, accepted=False, errors=None), *rows)
    caps_um = {i: cap for i, cap in report.caps_um.items() if i}
    noted = replace(report, presses=rows, notes=(evil,), caps_um=caps_um)
    renamed = replace(presses, presses=tuple(replace(p, name=r.name) for p, r in zip(presses.presses, rows)))
    hostile = replace(calibration, report=noted, sensor_name=evil, serial=evil, gel_id=evil)
    content = report_content(renamed, hostile, rng=np.random.default_rng(0))
    content["candidates"][0]["candidate"] = evil
    page = report_page(content, renamed, hostile)
    found = Page(page)
    assert "script" not in found.tags
    assert found.tags.count("img") == 1 + len(noted.caps_um)
    assert found.text.count("<script>") >= len(rows)


def test_it_parses_is_small_leads_to_its_sections_and_needs_nothing_from_outside(page):
    found = Page(page)
    anchors = [link[1:] for link in found.links if link.startswith("#")]
    assert len(anchors) == 10
    assert set(anchors) <= set(found.ids)
    assert len(found.ids) == len(set(found.ids))
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
    bare = replace(calibration, report=replace(calibration.report, caps_um={}))
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
        "smallest typical slope",
    ):
        assert text in drawn
    assert '<tr class="chosen"><td>b step 3e-05 ← chosen' in drawn
    assert "Only one model was tried" in shown(candidates=rows[:1])
    assert "decides" not in shown(candidates=rows[:1])


def test_places_to_press_are_said_in_words(content, shown):
    place = {"name": "top left", "x_px": 10, "y_px": 20, "contact_radius_px": 9.0}
    facts = {**content["calibration"], "mm_per_px": 0.1}
    drawn = shown(coverage={**content["coverage"], "next": [place]}, calibration=facts)
    assert "<ol> <li>top left: (10, 20) px, 1.0 mm from the left, 2.0 mm from the top</li> </ol>" in drawn


def test_slopes_and_places_stand_in_their_rows_and_a_missing_bin_is_a_dash(content, shown):
    where = content["where"]
    place = {"rows": 2, "columns": 2, "normal_deg": [1.0, 2.0, None, 3.0], "pixels": [99, 99, 0, 99]}
    contact, rim = {**where["contact"], "by_place": place}, {**where["rim"], "normal_deg": 77.77}
    page = shown(where={"contact_radius_ratio": 0.84, "contact": contact, "rim": rim})
    for said in (
        "edge, at 0.84 of the visible radius",
        "<tr><td>1.00°</td><td>2.00°</td></tr>",
        "<tr><td>–</td><td>3.00°</td></tr>",
    ):
        assert said in page
    assert len(contact["by_slope"]) > 3
    for b in contact["by_slope"]:
        slopes = f"{b['slope_from']:g} – {b['slope_to']:g}"
        assert f"<td>{slopes}</td><td>{b['normal_deg']:.2f}°</td><td>{b['pixels']}</td>" in page
    assert "77.77" not in page, "a second angle error"


def test_every_held_out_press_has_its_depth_picture_and_the_learning_sentence_is_there_or_why_not(
    content, shown
):
    held_out, drawn = [row["errors"]["cap_free_um"] for row in content["presses"] if row["errors"]], shown()
    assert re.findall(r"<figcaption>(\d+) µm", drawn) == [f"{one:.0f}" for one in held_out]
    assert content["learning"]["sentence"] in drawn
    assert "There is no learning curve" in shown(learning=None)


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
    colors = tab.evaluate(
        "[...document.querySelectorAll('section,.tag,td,body')].map(e => getComputedStyle(e).backgroundColor)"
    )
    painted = [re.findall(r"[\d.]+", color) for color in colors]  # grounds behind text, 0-255
    darkest = min(float(v) for one in painted if len(one) == 3 for v in one)
    assert darkest > 150, "dark ink on a dark ground: it was printed from a dark screen"
    browser.close()


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["a/0/gelsight.png", "a/1/gelsight.png"], ["a/0", "a/1"]),
        (["0.png", "10.png"], ["0", "10"]),
        (["0.png", "1.jpg"], ["0.png", "1.jpg"]),
        (["x10.png", "y10.png"], ["x10", "y10"]),
        (["x" * 50 + ".png", "y.png"], ["x" * 13 + "…" + "x" * 14, "y"]),
        (["only.png"], ["only"]),
        ([".png", "a.png"], [".png", "a"]),
    ],
)
def test_names_lose_what_all_share(names, short):
    assert short_names(names) == short


def decoded(url):
    data = np.frombuffer(base64.b64decode(url.split(",", 1)[1]), np.uint8)
    return cv2.imdecode(data, cv2.IMREAD_UNCHANGED)


def test_a_jpeg_is_rgb_and_no_wider_than_asked_and_many_are_small():
    image = np.zeros((120, 160, 3), dtype=np.uint8)
    image[:, :80, 0] = 200
    back = decoded(jpeg_url(image, 80))
    assert back.shape == (60, 80, 3)
    assert back[30, 10, 2] > 150 > back[30, 10, 0] + 100
    assert decoded(jpeg_url(image, 320)).shape == image.shape
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (120, 160, 3), dtype=np.uint8) for _ in range(12)]
    urls = press_urls(images, budget_bytes=60_000)
    assert sum(map(len, urls)) < 90_000
    assert decoded(urls[0]).shape[1] in WIDTHS_PX
    assert decoded(press_urls(images)[0]).shape[1] == 160


def test_too_high_is_red_too_low_blue_and_unknown_clear():
    error = np.zeros((40, 40), dtype=np.float32)
    error[:, :10], error[:, 30:] = 50, -50
    error[:10] = np.nan
    pixels = decoded(cap_url(error, 50.0))
    assert tuple(pixels[30, 3, 2::-1]) == HIGH
    assert tuple(pixels[30, 36, 2::-1]) == LOW
    assert pixels[30, 3, 3] == pixels[30, 36, 3] == 255
    assert pixels[30, 20, 3] == pixels[4, 3, 3] == 0


@pytest.mark.parametrize(("spread", "scale"), [(0.9, 1), (1.2, 2), (4.0, 5), (8.0, 10), (25.0, 50)])
def test_scales_are_round_and_hold_most_pixels(spread, scale):
    error = np.full((20, 20), spread, dtype=np.float32)
    error[0] = np.nan
    assert cap_scale_um([error]) == pytest.approx(scale)


CHARTS = templates().get_template("charts.html").module
SHAPE = (60, 80)


def test_axes_run_right_and_up_and_a_band_stays_in_the_plot():
    axes = Axes((0, 10), (0, 1), (), ())
    assert axes.x(0) < axes.x(5) < axes.x(10)
    assert axes.y(0) > axes.y(0.5) > axes.y(1)
    assert axes.x(5) - axes.x(0) == pytest.approx(axes.x(10) - axes.x(5))
    ys = [float(pair.split(",")[1]) for pair in axes.band((0, 10), (-5, -5), (9, 9)).split()]
    assert (min(ys), max(ys)) == pytest.approx((axes.y(1), axes.y(0)), abs=0.1)


def elements(drawn, tag, kind):
    return [e for e in ElementTree.fromstring(drawn.strip()).iter(tag) if e.get("class") == kind]


def circles(drawn, kind):
    return [(float(c.get("cx")), float(c.get("cy"))) for c in elements(drawn, "circle", kind)]


def bins_of(name, values):
    """Bins of slopes a tenth wide, with a figure each."""
    return [
        {"slope_from": 0.1 * k, "slope_to": 0.1 * k + 0.1, name: value, "interval": [0.5, 1.3]}
        for k, value in enumerate(values)
    ]


def test_a_gain_below_one_is_drawn_below_the_line():
    bins, beyond = bins_of("gain", (1.1, 1.0, 0.9)), bins_of("gain", (0.8, 0.7, 0.6))
    dots = circles(CHARTS.gain_chart({"contact": bins, "rim": []}), "dot-first")
    assert [x for x, _ in dots] == sorted(x for x, _ in dots)
    assert dots[0][1] < dots[1][1] < dots[2][1]
    assert not CHARTS.gain_chart({"contact": [], "rim": []}).strip()
    both = CHARTS.gain_chart({"contact": bins, "rim": beyond})
    assert circles(both, "dot-first") == dots, "one gain: of the contact"
    assert circles(both, "dot-second") == []


def test_the_learning_chart_has_every_draw_and_what_is_expected(learning):
    drawn = CHARTS.learning_chart({**learning, "sentence": '<script>"&'})
    assert "<script>" not in drawn
    assert elements(drawn, "svg", "chart")[0][0].text == 'Learning curve: <script>"&'
    assert len(circles(drawn, "draw")) == sum(len(p["draws_deg"]) for p in learning["points"])
    (now, _), (later, _) = circles(drawn, "expected")
    assert now < later
    assert f"now: {learning['expected']['presses_now']}" in drawn


def test_shares_stand_in_their_bars_and_cells_and_far_off_ones_by_the_percents_that_are_printed():
    drawn = CHARTS.sigma_chart({"by_slope": bins_of("share", (0.68, 0.5, 0.2))})
    bars = [rect.get("class") for rect in ElementTree.fromstring(drawn.strip()).iter("rect")]
    assert bars == ["bar", "bar off", "bar far"]
    assert not CHARTS.sigma_chart({"by_slope": []}).strip()
    for kind, percents in (("bar", (59.6, 60, 76.4)), ("bar off", (59.4, 76.6)), ("bar far", (44.4,))):
        assert {bar_of(percent) for percent in percents} == {kind}
    grid = {"rows": 1, "columns": 3, "by_place": [0.68, None, 0.3]}
    texts = [e.text for e in elements(CHARTS.share_map(grid, SHAPE), "text", "cell")]
    assert texts == ["68 %", "–", "30 %"]


def test_markers_lie_between_their_limits_and_ranges_share_a_scale():
    (x, _), *_ = circles(CHARTS.limit_bar(2.0, [1.5, 2.5], 3, 5), "marker")
    (good,) = elements(CHARTS.limit_bar(2.0, [1.5, 2.5], 3, 5), "rect", "zone-good")
    assert 0 < x < float(good.get("width"))
    (far, _), *_ = circles(CHARTS.limit_bar(50.0, None, 3, 5), "marker")
    assert far <= 200
    bars = [CHARTS.range_bar({"normal_free_deg": v, "chosen": False}, 5) for v in (2.0, 4.0)]
    one, two = (circles(bar, "dot-first")[0][0] for bar in bars)
    assert two == pytest.approx(2 * one)


def coverage(counts):
    place = {"x_px": 59.5, "y_px": 14.5, "contact_radius_px": 10.0}
    return {"rows": 1, "columns": 2, "presses": counts, "next": [place]}


def test_a_petal_is_empty_where_no_press_was_octant_zero_is_on_the_right_and_the_next_press_at_its_place():
    drawn = CHARTS.coverage_map(coverage([[0, 1, 2, 3, 9, 0, 0, 0], [1] * 8]), SHAPE)
    petals = elements(drawn, "path", "petal")
    assert len(petals) == 12
    assert len(elements(drawn, "path", "petal none")) == 4
    opacities = [float(p.get("fill-opacity")) for p in petals[:4]]
    assert opacities[0] < opacities[1] < opacities[2] == opacities[3]
    drawn = CHARTS.coverage_map(coverage([[1] * 8] * 2), SHAPE)
    mark, scale = elements(drawn, "circle", "next")[0], 560 / 80
    place = [float(mark.get(name)) for name in ("cx", "cy", "r")]
    assert place == pytest.approx([60 * scale, 15 * scale, 10 * scale], abs=0.1)
    first = elements(drawn, "path", "petal")[0].get("d")
    start, line = (float(first.split(letter)[1].split()[0]) for letter in "ML")
    assert line > start


def test_arrows_point_along_the_error_and_empty_cells_stay_blank():
    means = [[0.1, 0], [0, 0.2], None, [0, 0]]
    errors = {"rows": 2, "columns": 2, "rms": [0.1, 0.2, None, 0.05], "mean": means}
    drawn = CHARTS.slope_error_map(errors, SHAPE)
    assert len(elements(drawn, "rect", "heat")) == 3
    right, down, still = elements(drawn, "line", "arrow")
    assert float(right.get("x2")) > float(right.get("x1"))
    assert right.get("y2") == right.get("y1")
    assert float(down.get("y2")) > float(down.get("y1"))
    assert still.get("x2") == still.get("x1")
    assert scale_of_errors({"rms": [None]}) == 1.0
