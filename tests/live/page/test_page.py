"""The page in a real browser: pixels, numbers, buttons, lost connections, accessibility.

The layout on a desktop and on a phone: legends, messages, reachable buttons; outdated figures are dimmed.

The page's tools: the ruler, curves of minutes, the surface in full screen.
"""

import math
import os
import re
import threading
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.depth.contact import contacts_from_mask
from gelform.errors import SourceLostError
from gelform.exchange.plots import save_picture
from gelform.live.station import Opening, Setup
from gelform.sensors.films import open_film
from gelform.sensors.playback import Player
from live_waiting import until

pytestmark = pytest.mark.slow

AXE = Path(os.environ.get("GELFORM_AXE", "node_modules/axe-core/axe.min.js"))


def pixels(page, pane, x, y, width=1, height=1):
    """RGB (N, 3) of a part of the map that a pane draws."""
    script = """([pane, ...part]) => {
        const context = gelform.panes[pane].painting.canvas.getContext("2d");
        return [...context.getImageData(...part).data];
    }"""
    return np.array(page.evaluate(script, [pane, int(x), int(y), width, height])).reshape(-1, 4)[:, :3]


def test_colors_profile_and_numbers_are_those_of_the_array(page, still):
    colormaps = pytest.importorskip("matplotlib").colormaps
    depth, top = still.depth_mm, page.evaluate("gelform.settings.range")
    row, column = np.unravel_index(depth.argmax(), depth.shape)
    for y, x in ((row, column), (row, column + 12), (5, 5)):
        wanted = 255 * np.array(colormaps["viridis"](max(0.0, depth[y, x] / top)))[:3]
        np.testing.assert_allclose(pixels(page, 0, x, y)[0], wanted, atol=12)
    normals = gelform.normals_from_gradients(gelform.gradients_from_depth(depth, mm_per_px=still.mm_per_px))
    for y, x in ((row, column + 12), (row - 9, column), (0, 0), (-1, -1)):
        shown = pixels(page, 2, x % depth.shape[1], y % depth.shape[0])[0]
        np.testing.assert_allclose(shown, 127.5 + 127.5 * normals[y, x], atol=2)
    script = """([x, y]) => import('/js/maps/charts.js').then((module) => {
        const { alongX, alongY } = module.profilesThrough(gelform.frame, [x, y]);
        return [[...alongX], [...alongY]];
    })"""
    along_x, along_y = page.evaluate(script, [int(column), int(row)])
    np.testing.assert_allclose(along_x, depth[row], atol=1e-4)
    np.testing.assert_allclose(along_y, depth[:, column], atol=1e-4)
    until(lambda: page.inner_text("#number-peak .value").startswith(f"{depth.max():.3f}"))
    assert page.evaluate("gelform.look.renderer").startswith("WebGL2")


@pytest.fixture
def blinded(page, station):
    """The sensor with a rectangle so bright that nothing is known of it."""
    seen = station.source.image_at

    def image_at(index):
        image = seen(index)
        image[80:110, 20:60] = 255
        return image

    station.source.image_at = image_at
    until(lambda: page.evaluate("gelform.frame.has('unknown')"))


def test_what_is_not_known_is_hatched_and_never_a_depth(page, blinded, still, picture):
    """On maps, in the profile and on the surface, though the solver filled it in."""
    known = still.known
    assert not known[90:100, 30:50].any()
    swatches = page.locator(".pane >> nth=0 >> .swatch")

    def is_hatched():
        grays = {(138, 148, 153), (93, 103, 108)}
        return set(map(tuple, pixels(page, 0, 30, 90, 20, 10).tolist())) == grays

    for view, unknown in (("depth", True), ("image", False), ("normals", True)):  # each unlike the one before
        page.select_option(".pane select >> nth=0", view)
        until(lambda unknown=unknown: is_hatched() is unknown)
        until(lambda count=int(unknown): swatches.count() == count)
    script = """() => import('/js/maps/charts.js').then(({ profilesThrough }) => {
        const { alongX, depth } = profilesThrough(gelform.frame, [40, 95]);
        return [alongX.map(Number.isNaN), Number.isNaN(depth)];
    })"""
    unknown_along_x, unknown_there = page.evaluate(script)
    np.testing.assert_array_equal(unknown_along_x, ~known[95])
    assert unknown_there

    shown = picture(page, "#surface").astype(int)
    page.evaluate("gelform.frame.planes.unknown.values.fill(0)")
    page.evaluate("gelform.surface.orbit.changed()")

    def changed(filled):
        return np.abs(shown - filled).max(axis=-1) > 20

    until(lambda: changed(picture(page, "#surface")).sum() > 500)
    filled = picture(page, "#surface")
    of_hatch, of_depth = (np.median(np.ptp(one[changed(filled)], axis=-1)) for one in (shown, filled))
    assert of_hatch < 12 < of_depth  # gray: channels alike


def test_the_surface_wears_the_confidence_whatever_the_panes_show(page, blinded, picture):
    assert "confidence" not in page.evaluate("gelform.panes.map((one) => one.view)")
    page.select_option("#drape", "confidence")
    until(lambda: page.evaluate("gelform.frame.has('confidence')"))
    until(lambda: "colors: confidence" in page.inner_text("#stage .corner"))
    yellow = np.array([37, 231, 253])  # BGR of 1, of which the most part is; lit, it keeps its hue

    def yellow_pixels():
        bright = picture(page, "#surface").astype(float)
        bright /= np.maximum(bright.max(axis=-1, keepdims=True), 1)
        return int((np.abs(bright - yellow / 253).max(axis=-1) < 0.15).sum())

    until(lambda: yellow_pixels() > 10_000)
    page.select_option("#drape", "depth")
    until(lambda: yellow_pixels() < 1_000)


def test_buttons_do_what_they_say(page, station):
    page.click("#zero")
    until(lambda: station.setup.memory.zero is not None)
    until(lambda: page.inner_text("#zero") == "Undo zero")
    page.click("#zero")
    until(lambda: station.setup.memory.zero is None)
    page.select_option("#colors", "cividis")
    assert page.evaluate("gelform.settings.colors") == "cividis"
    page.click("#snapshot")
    until(lambda: page.locator(".toast a").count() == 4)
    with page.expect_download() as surface:
        page.click(".toast a >> nth=2")
    assert surface.value.path().read_bytes().startswith(b"ply")
    with page.expect_download() as download:
        page.click(".toast a >> nth=0")
    assert cv2.imread(str(download.value.path())).shape == (*station.newest.result.shape, 3)
    page.click("#background")
    until(lambda: "Something seems to touch the gel" in page.inner_text("#toasts"))
    page.click("#undo-background")
    until(lambda: not page.is_visible("#undo-background"))
    assert station.setup.background is None
    station.source.lift()
    until(lambda: station.newest.numbers.peak < 0.05)
    page.keyboard.press("b")
    until(lambda: page.is_visible("#undo-background"))
    until(lambda: "the average of 15 frames" in page.inner_text("#toasts"))
    assert station.setup.background is not None
    page.click("#undo-background")
    until(lambda: not page.is_visible("#undo-background"))
    assert station.setup.background is None


def test_the_numbers_are_of_the_frame_that_the_maps_show(visit, station):
    """While the ball goes in and out, at every drawing."""
    page = visit()
    until(lambda: page.evaluate("gelform.frame?.header.peak !== undefined"), 30)
    script = """() => new Promise((found) => {
        const apart = [];
        const look = () => {
            const { frame } = gelform.panes[0];
            const peak = frame.header.peak.toFixed(3).replace("-0.000", "0.000");
            apart.push([frame.header.serial, peak, document.querySelector("#number-peak .value").textContent]);
            if (apart.length < 60) requestAnimationFrame(look); else found(apart);
        };
        look();
    })"""
    station.source.press_at(88, 66, 0.5)
    seen = page.evaluate(script)
    assert len({serial for serial, *_ in seen}) > 5
    assert [said.startswith(peak) for _, peak, said in seen] == [True] * len(seen)


def test_every_view_can_be_chosen_and_details_are_folded_until_they_are_asked_for(page):
    for view in page.evaluate("Object.keys(gelform.views)"):
        page.select_option(".pane select >> nth=0", view)
        until(lambda: page.evaluate("gelform.panes[0].painting.image !== null"))
        until(lambda view=view: page.locator(f".pane[data-view={view}]").count() >= 1)
    assert not page.is_visible("#facts")
    page.click("#facts-card summary")
    until(lambda: "capture to screen" in page.inner_text("#facts"))


def test_a_recording_ends_with_its_tab_but_not_when_it_is_loaded_anew(visit, hub, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.live.hub.GRACE_S", 3.0)
    hub.folder = tmp_path
    recording, other = visit(), visit()
    recording.click("#record")
    until(lambda: hub.recorders)
    recording.reload()
    until(lambda: recording.evaluate("Boolean(window.gelform?.facts)"))
    until(lambda: recording.inner_text("#record").startswith("Stop, "))
    assert hub.recorders
    other.click("#pause")  # another page is in use meanwhile
    recording.close()
    until(lambda: not hub.recorders)
    until(lambda: "was closed" in other.inner_text("#toasts"))
    assert len(list(tmp_path.glob("recording-*"))) == 1


def test_a_lost_connection_is_said_and_comes_back(page):
    page.evaluate("gelform.connection.socket.close()")
    serial = page.evaluate("gelform.frame.header.serial")
    until(lambda: page.evaluate("gelform.connection.open"))
    until(lambda: page.evaluate("gelform.frame.header.serial") > serial + 3)
    until(lambda: page.is_hidden("#banner"))


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_nothing_serious_for_those_who_see_or_point_badly(page, hub, theme, simulated, tmp_path, show):
    """With all that the page can show: two sensors, a recording that is held, the ruler, a message, the guide."""
    if not AXE.is_file():
        pytest.skip(f"no axe-core in {AXE}: npm install axe-core, or set GELFORM_AXE")
    for k, press in enumerate(simulated.presses[:2]):
        save_picture(tmp_path / f"{k}.png", press.image)
    show(Opening(lambda: Player(open_film(tmp_path)), math.inf), hub)
    (tmp_path / "session.mcap").write_bytes(bytes(2000))
    hub.recordings.add(tmp_path)
    hub.recordings.add(tmp_path / "session.mcap")
    until(lambda: page.locator(".chooser").count() == 2)
    page.click(".chooser >> nth=1")
    until(lambda: page.is_visible("#replay"))
    page.click("#measure")
    hub.notice("The camera is set otherwise than it was calibrated.", "warning")
    page.evaluate(AXE.read_text(encoding="utf-8"))
    if page.evaluate("document.documentElement.dataset.theme") != theme:
        page.click("#theme")
    for tab in ("live", "calibrate"):
        page.click(f"#tab-{tab}")
        page.wait_for_timeout(300)
        found = page.evaluate("axe.run({ resultTypes: ['violations'] })")["violations"]
        serious = [
            (one["id"], [node["target"] for node in one["nodes"]])
            for one in found
            if one["impact"] in ("serious", "critical")
        ]
        assert serious == []


def test_a_gel_that_is_another_one_has_no_surface_and_no_figures(page, station, calibration):
    """Neither the last surface that was known nor a flat one of 0.000 mm: a dash, and why."""
    background = np.ascontiguousarray(calibration.background[::-1, ::-1, [2, 0, 1]])
    other = replace(calibration, background=background)
    station.setup = Setup(other, "mine")
    until(lambda: "This frame cannot be reconstructed" in page.inner_text(".empty"))
    until(lambda: page.inner_text("#number-peak .value") == "–")
    until(lambda: page.inner_text("#profile-at") == "–")
    (reason,) = [one.message for one in station.newest.result.health if one.name == "not_this_gel"]
    assert reason in page.inner_text(".empty")
    until(lambda: not page.evaluate("gelform.frame.has('depth')"))


SIZES = {"desk": {"width": 1400, "height": 900}, "phone": {"width": 390, "height": 844}}


@pytest.fixture(params=SIZES.values(), ids=SIZES)
def sized(page, request):
    """The page at a size, which it has been laid out for."""
    page.set_viewport_size(request.param)
    until(lambda: page.evaluate("document.documentElement.clientWidth") == request.param["width"])
    script = "gelform.panes[0].node.parentNode.clientWidth"
    until(lambda: abs(box(page, "#panes")["width"] - page.evaluate(script)) < 1)
    yield page
    page.set_viewport_size({"width": 1100, "height": 900})


def box(page, place):
    return page.locator(place).first.bounding_box()


def is_inside(inner, outer):
    return all(
        outer[at] - 0.5 <= inner[at] and inner[at] + inner[size] <= outer[at] + outer[size] + 0.5
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_the_legend_of_why_pixels_are_not_trusted_stays_in_its_pane(sized):
    sized.select_option(".pane select >> nth=0", "causes")
    swatches = sized.locator(".pane >> nth=0 >> .legend .named")
    until(lambda: swatches.count() > 5)
    legend = box(sized, ".pane >> nth=0 >> .legend")
    assert is_inside(legend, box(sized, ".pane"))
    boxes = [swatches.nth(k).bounding_box() for k in range(swatches.count())]
    assert all(is_inside(one, legend) for one in boxes)
    places = {(round(one["x"]), round(one["y"])) for one in boxes}
    assert len(places) == len(boxes), "none lies on another"


NEEDED = "#theme, #help, .tabs button, #status, main button, main select, main input, main canvas"


def are_apart(one, other):
    return any(
        b[at] >= a[at] + a[size]
        for a, b in ((one, other), (other, one))
        for at, size in (("x", "width"), ("y", "height"))
    )


def test_messages_cover_nothing_have_a_cross_and_go(sized, hub):
    hub.notice("The disk is almost full. " * 5, "error")
    hub.notice("Zero set: depth is relative to the last frames.")
    until(lambda: sized.locator(".toast").count() == 2)
    toasts = [sized.locator(".toast").nth(k).bounding_box() for k in range(2)]
    screen = {"x": 0, "y": 0, **sized.viewport_size}
    assert all(is_inside(one, screen) for one in toasts)
    script = f"""() => [...document.querySelectorAll({NEEDED!r})].filter((one) => one.checkVisibility())
        .map((one) => one.getBoundingClientRect()).map(({{ x, y, width, height }}) => ({{ x, y, width, height }}))"""
    for one in sized.evaluate(script):
        for toast in toasts:
            assert are_apart(one, toast), (one, toast)
    sized.get_by_role("button", name="Dismiss").first.focus()
    sized.keyboard.press("Enter")
    until(lambda: sized.locator(".toast").count() == 1)
    until(lambda: sized.locator(".toast").count() == 0, 25)  # by itself


def test_nothing_is_wider_than_the_screen_and_the_background_is_within_reach(sized):
    width, height = sized.viewport_size["width"], sized.viewport_size["height"]
    wide = f"[...document.querySelectorAll('main *')].filter(one => one.getBoundingClientRect().right > {width + 1})"
    until(lambda: sized.evaluate(f"{wide}.length") == 0)
    for button in ("#background", "#zero"):
        found = box(sized, button)
        assert found["height"] >= 30
        assert found["y"] + found["height"] <= height, "without scrolling"


def test_figures_are_dimmed_while_there_are_no_new_ones(page, station):
    back = threading.Event()

    def image_at(_):
        back.wait(60)
        raise SourceLostError("The camera was unplugged.")

    opacity = "getComputedStyle(document.querySelector('#number-peak .value')).opacity"
    until(lambda: page.evaluate(opacity) == "1")
    station.source.image_at = image_at
    until(lambda: page.inner_text("#status").startswith("reconnecting"))
    until(lambda: float(page.evaluate(opacity)) < 0.5)
    for place in (".pane .map", "#surface"):
        script = opacity.replace("#number-peak .value", place)
        until(lambda script=script: float(page.evaluate(script)) < 0.5)
    back.set()  # the next source is another one: whole again
    until(lambda: page.inner_text("#status").startswith("live"))
    until(lambda: page.evaluate(opacity) == "1")
    page.evaluate("gelform.connection.socket.onclose = null; gelform.connection.lost('')")
    until(lambda: float(page.evaluate(opacity)) < 0.5)  # the server does not answer


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
    by_server = gelform.measure(still, lines=[(ax, ay, bx, by)]).quantities
    until(lambda: page.inner_text("#ruler [role=status]").startswith(", ".join(map(str, by_server))))
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
