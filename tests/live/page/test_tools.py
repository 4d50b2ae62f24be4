"""The page's tools: the ruler, curves of minutes, the surface in full screen."""

import re
from dataclasses import asdict

import cv2
import numpy as np
import pytest

from gelform.depth.contact import contacts_from_mask
from live_waiting import until

pytestmark = pytest.mark.slow


def test_cards_have_the_force_with_its_sigma_or_the_reason_and_each_of_several_contacts(page):
    """Each is hidden without: so the cards are read at once, before the next frame."""
    assert page.locator("#force-card").is_hidden()
    script = """async ([draw, header, card]) => {
        (await import('/js/panels/status.js'))[draw]({ header });
        return document.getElementById(card).innerText;
    }"""
    names = ("shear_x_n", "shear_y_n", "shear_sigma_n", "torsion_n_mm", "torsion_sigma_n_mm")
    force = {"normal_n": 4.2, "normal_sigma_n": 1.1, "force_reason": "no dots", **dict.fromkeys(names)}
    said = page.evaluate(script, ["drawForce", {"force": force}, "force-card"])
    assert re.search(r"into the gel\s+4\.20 ± 1\.10 N", said)
    assert re.search(r"shear x\s+–", said)
    assert "no dots" in said
    mask = np.zeros((40, 60), dtype=bool)
    mask[4:10, 4:14] = mask[20:30, 50:60] = True
    contacts, _ = contacts_from_mask(mask, np.where(mask, np.float32(0.25), 0), mm_per_px=0.1)
    said = page.evaluate(
        script, ["drawContacts", {"contacts": [asdict(one) for one in contacts]}, "contacts"]
    )
    lines = [" ".join(line.split()) for line in said.splitlines()]
    assert lines == ["50, 20 0.250 1.0 cut by the border", "4, 4 0.250 0.6"]


def click_at(page, view, x, y):
    """Click a map in its pane at a pixel of the image."""
    page.evaluate("() => gelform.panes[0].map.scrollIntoView({ block: 'center' })")
    box = page.locator(f"#panes .pane[data-view={view}] .map").bounding_box()
    px = box["width"] / 176
    page.mouse.click(box["x"] + (x + 0.5) * px, box["y"] + (y + 0.5) * px)


def test_the_ruler_measures_between_two_points(page, still):
    """Clicked or typed: the distance along the gel, and how much deeper the second one is."""
    page.click("#measure")
    until(lambda: "two points" in page.inner_text("#ruler output"))
    click_at(page, "depth", 30, 100)
    click_at(page, "image", 120, 60)  # on the simulated sensor's camera too, which is pressed else
    until(lambda: "apart" in page.inner_text("#ruler output"))
    ends = page.evaluate("gelform.stages[0].ruler.ends")
    np.testing.assert_allclose(ends, [[30, 100], [120, 60]], atol=1)
    (ax, ay), (bx, by) = ends
    measured = page.evaluate("gelform.stages[0].ruler.measured(gelform.frame)")
    assert measured["distance"] == pytest.approx(np.hypot(bx - ax, by - ay) * still.mm_per_px)
    rise = float(still.depth_mm[by, bx] - still.depth_mm[ay, ax])
    assert rise > 0.3
    assert measured["rise"] == pytest.approx(rise, abs=1e-4)
    said = f"A and B are {measured['distance']:.2f} mm apart, B is {measured['rise']:.3f} mm deeper."
    until(lambda: page.inner_text("#ruler output") == said)
    shown = [float(page.input_value(f"#ruler input >> nth={k}")) for k in range(4)]
    np.testing.assert_allclose(shown, np.array([ax, ay, bx, by]) * still.mm_per_px, atol=0.006)
    assert page.get_attribute("#ruler input >> nth=3", "aria-label") == "B, y in mm"
    page.fill("#ruler input >> nth=2", f"{35 * still.mm_per_px:.3f}")
    page.fill("#ruler input >> nth=3", f"{101 * still.mm_per_px:.3f}")
    until(lambda: page.inner_text("#ruler output") != said)
    assert page.evaluate("gelform.stages[0].ruler.ends[1]") == [35, 101]
    unknown = "{ ...gelform.frame.planes.depth, values: new Uint8Array(132 * 176).fill(1) }"
    page.evaluate(f"gelform.frame.planes.unknown = {unknown}")
    page.evaluate("document.dispatchEvent(new Event('laidout'))")  # draws again
    # The longer sentence moves what is below it, also a button that is being clicked.
    until(lambda: page.inner_text("#ruler output").endswith("in depth is not known."))
    page.keyboard.press("Escape")
    page.click("#measure")
    until(lambda: page.is_hidden("#ruler"))


def test_curves_reach_back_for_minutes_and_keep_their_peaks(page, station):
    """Numbers of five minutes come at once, and what is drawn of them has each part's largest and least."""
    now_s = station.newest.frame.time_s
    times_s = now_s - 300 + np.arange(8900) / 30
    before = [((k + 1) / 1e4, t, 0.9 if k == 4000 else 0.1, 1.0, 1.0) for k, t in enumerate(times_s.tolist())]
    station.paused = True
    until(lambda: page.evaluate("gelform.frame.header.serial") == station.newest.serial)
    station._numbers.extendleft(reversed(before))
    station.paused = False
    page.reload()
    until(lambda: page.evaluate("window.gelform?.series?.time.length > 1000"))
    script = "(s) => { const { time } = gelform.series.recent('peak', s); return time.at(-1) - time[0]; }"
    spans = [page.evaluate(script, s) for s in (10, 300)]
    assert spans[0] <= 10
    assert 250 < spans[1] <= 300
    assert page.evaluate("Math.max(...gelform.series.peak)") == 0.9
    picture = "document.getElementById('time').toDataURL()"
    before_it = page.evaluate(picture)
    page.select_option("#span", "300")
    until(lambda: page.evaluate(picture) != before_it)
    script = """() => import('/js/maps/charts.js').then(({ thinned }) => {
        const time = Array.from({ length: 20000 }, (_, k) => k / 60);
        const values = time.map((t, k) => (k === 7777 ? 5 : Math.sin(k)));
        const { time: t, values: v } = thinned(time, values, 300);
        return [t.length, v.includes(5), t[v.indexOf(5)] * 60, t.every((one, k) => !k || one > t[k - 1])];
    })"""
    length, has_peak, at, grows = page.evaluate(script)
    assert length <= 2 * 301
    assert (has_peak, grows, at) == (True, True, pytest.approx(7777))


def drawn(picture, page):
    """Where the surface's picture differs from the stage behind it: its height and width in parts of the canvas."""
    pixels = cv2.cvtColor(picture(page, "#surface"), cv2.COLOR_BGR2HSV)
    rows, columns = np.nonzero((pixels[..., 1] > 90)[: int(0.9 * len(pixels))])
    height, width = pixels.shape[:2]
    return np.ptp(rows) / height, np.ptp(columns) / width


def test_the_surface_fills_its_stage_and_the_screen_has_smooth_edges_and_turns(page, still, picture):
    page.evaluate("scrollTo(0, 0)")
    assert page.evaluate("gelform.surface.gl.getContextAttributes().antialias")
    assert page.evaluate("gelform.surface.gl.getParameter(gelform.surface.gl.SAMPLES)") > 1
    until(lambda: max(drawn(picture, page)) > 0.7)
    page.set_viewport_size({"width": 390, "height": 844})
    until(lambda: page.evaluate("document.getElementById('surface').clientWidth") < 390)
    until(lambda: max(drawn(picture, page)) > 0.8)
    page.set_viewport_size({"width": 1100, "height": 900})
    page.click("#whole")
    until(lambda: page.locator("#stage").bounding_box() == {"x": 0, "y": 0, **page.viewport_size})
    until(lambda: max(drawn(picture, page)) > 0.7)
    assert page.is_visible("#reset-view")
    before = picture(page, "#surface").astype(int)
    page.focus("#surface")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    until(lambda: np.abs(picture(page, "#surface") - before).mean() > 1)
    page.evaluate("document.fullscreenElement ? document.exitFullscreen() : null")
    page.keyboard.press("Escape")
    until(lambda: page.locator("#stage").bounding_box()["height"] < 700)
    until(lambda: page.get_attribute("#whole", "aria-pressed") == "false")
