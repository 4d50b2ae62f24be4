"""A guided calibration: what its images show, its steps faster than real time, its files and figures."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gelform
from gelform.calibration import guide as module
from gelform.calibration.circles import find as find_module
from gelform.calibration.guide import LEAST, NEXT_PLACES, STILL_LOOKS, Guide, Judge
from gelform.calibration.starters import load_starter
from gelform.errors import GelformError
from gelform.image.background import USUAL_FRAMES
from gelform.image.view import Frame
from gelform.sensors.files import SensorSettings
from gelform.sensors.profiles import PROFILES, SENSORS
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press
from made.images import halved

BALL_MM = 5.0


@pytest.fixture(scope="session")
def untouched(sensor):
    return np.asarray(simulate_background(sensor, np.random.default_rng(31)), np.uint8)


@pytest.fixture
def judge(sensor, untouched):
    background = np.asarray(simulate_background(sensor, None), np.float32)
    return Judge(background, untouched, sensor.noise_sd, BALL_MM / 2 / sensor.mm_per_px)


@pytest.fixture
def press(sensor):
    """An image of a ball pressed somewhere (mm from the middle), with its truth."""

    def made(x_mm=0.0, y_mm=0.0, depth_mm=0.4, seed=1, diameter_mm=BALL_MM):
        ball, rng = Ball(diameter_mm / 2), np.random.default_rng(seed)
        return simulate_press(sensor, ball, depth_mm=depth_mm, center_mm=(x_mm, y_mm), rng=rng, oversample=1)

    return made


def looked(judge, image, accepted=()):
    judge.look(image)
    return judge.look(image, accepted)


def test_untouched_is_untouched_whatever_the_noise(judge, sensor):
    for seed in range(5):
        look = judge.look(np.asarray(simulate_background(sensor, np.random.default_rng(seed)), np.uint8))
        assert not look.touched


@pytest.mark.parametrize(("x_mm", "y_mm"), [(0, 0), (5, -3), (-6, 4)])
def test_a_press_is_found_where_it_is(judge, press, x_mm, y_mm):
    made = press(x_mm, y_mm)
    look = looked(judge, made.image)
    assert look.reason == ""
    assert not look.moving
    assert look.circle[:2] == pytest.approx(made.center_px, abs=1.5)
    assert look.circle[2] == pytest.approx(made.contact_radius_px, rel=0.35)


def test_a_ball_that_moves_is_not_still(judge, press):
    judge.look(press(0, 0).image)
    assert judge.look(press(1.0, 0).image).moving
    assert not judge.look(press(1.0, 0, seed=2).image).moving


def test_reasons_say_what_to_do(judge, press):
    here = press(2, 1)
    x, y, radius = looked(judge, here.image).circle
    for share, reason in ((0.35, "You pressed here before. Press at the circle."), (0.45, "")):
        assert looked(judge, here.image, [(x + share * radius, y, radius)]).reason == reason
    assert "harder" in looked(judge, press(0, 0, depth_mm=0.055).image).reason
    assert "too deep" in looked(judge, press(0, 0, depth_mm=0.7, diameter_mm=14).image).reason


def test_an_image_of_another_sensor_is_refused_with_the_reason(judge, untouched):
    assert "BGR" in looked(judge, untouched[..., ::-1].copy()).reason


def test_what_is_known_of_a_camera_is_kept(monkeypatch):
    """The make's gel too, and the settings under which its images are taken; also where a starter came first."""
    camera = SimpleNamespace(name="GelSight Mini 2BKR", serial="2BKR", settings={"exposure": 50.0})
    make = "gelsight-mini"
    monkeypatch.setitem(PROFILES, make, replace(PROFILES[make], gel_thickness_mm=4.2))
    known = Guide.of(camera, (240, 320), BALL_MM, profile=make).settings
    assert (known.serial, known.make, known.camera) == ("2BKR", make, {"exposure": 50.0})
    assert known.gel_thickness_mm == 4.2
    rest = simulate_background(SENSORS[make].simulated(), None)
    begun = Guide.of(
        camera, (240, 320), BALL_MM, profile=make, begun=load_starter(make).for_frame(rest)
    ).settings
    assert (begun.serial, begun.make, begun.camera) == (known.serial, known.make, known.camera)
    assert begun.gel_thickness_mm is None, "the calibration in use knows none"


@pytest.fixture
def guide(sensor, monkeypatch):
    monkeypatch.setattr(module, "LOOK_EVERY_S", 0.0)
    return Guide(SensorSettings("small", sensor.mm_per_px, make="gelsight-mini"), 5.0)


@pytest.fixture
def see(guide, sensor):
    """Shows the guide an image so many times, each with noise of its own where it is None: untouched."""
    rng = np.random.default_rng(5)

    def shown(image=None, times=1):
        for k in range(times):
            pixels = np.asarray(simulate_background(sensor, rng), np.uint8) if image is None else image
            guide.look_at(Frame(pixels, 0.0, 0, k))

    return shown


def test_the_background_comes_first_then_a_place_to_press(guide, see):
    see(times=USUAL_FRAMES - 1)
    assert guide.step == "background"
    see()
    assert guide.step == "press"
    assert guide.target is not None
    assert guide.target.name in guide.hint
    assert guide.facts()["places"][0][2] == pytest.approx(0.55 * 2.5 / guide.settings.mm_per_px)


def test_a_background_in_which_something_touches_the_gel_is_taken_again_and_a_damaged_gel_is_in_the_end():
    mini = SENSORS["gelsight-mini"].simulated()
    touched = simulate_press(mini, Ball(2.5), depth_mm=0.4, center_mm=(2, 1), rng=None).image
    own = Guide(SensorSettings("my Mini", mini.mm_per_px, make="gelsight-mini"), BALL_MM)
    for _ in range(5):
        for _ in range(USUAL_FRAMES):
            own._add_untouched(touched)
        assert own.step == "background"
        assert re.search(r"Something seems to touch the gel .* Touch nothing: the page tries again", own.hint)
    for _ in range(USUAL_FRAMES):
        own._add_untouched(touched)
    assert own.step == "press"


def test_a_press_held_still_is_accepted_once(guide, see, press):
    see(times=USUAL_FRAMES)
    made = press(3, 2)
    see(made.image, STILL_LOOKS)
    assert guide.count == 0
    see(made.image, 10)
    assert guide.count == 1
    assert guide.facts()["accepted"][0][:2] == pytest.approx(made.center_px, abs=1.5)
    assert "Lift" in guide.hint
    see()
    assert guide.target.name in guide.hint


def test_a_click_takes_a_press_where_no_ball_is_seen_and_gives_its_circle(guide, see, press, monkeypatch):
    """As if its colors were as bright all around and no ball's; the click is forgotten with the press."""
    see(times=USUAL_FRAMES)
    see(press(3, 2).image, STILL_LOOKS + 1)
    seen, find = guide.facts()["accepted"][0], module.find_contact
    see()
    monkeypatch.setattr(
        module, "find_contact", lambda change: replace(find(change), x_px=9.0, antisymmetry=0.1)
    )
    monkeypatch.setattr(find_module, "MIN_EVIDENCE", np.inf)
    other = press(-3, 2)
    see(other.image, STILL_LOOKS + 1)
    assert guide.count == 1
    assert "click the middle" in guide.hint
    guide.click(*other.center_px)
    see(other.image, STILL_LOOKS + 1)
    assert guide.count == 2
    circle = guide.facts()["accepted"][1]
    assert circle[:2] == pytest.approx(other.center_px)
    assert circle[2] == pytest.approx(seen[2], rel=0.15)
    see()
    see(press(0, -3).image, STILL_LOOKS + 1)
    assert guide.count == 2
    monkeypatch.setattr(module, "LEAST", 2)
    assert [one.center_px for one in guide.presses().presses] == [None, other.center_px]


@pytest.mark.slow
def test_a_home_made_sensor_is_guided_as_its_folder_is_calibrated(data):
    """Its imprints are even, so that the color change is hardly odd: the finder of `calibrate` sees each ball."""
    presses = halved(gelform.read_presses(data / "homemade-even" / "a").subset(range(0, 9, 2)))
    background = np.asarray(presses.background, np.float32)
    still = np.rint(background).astype(np.uint8)
    ball_px = presses.presses[0].ball_diameter_mm / 2 / presses.mm_per_px
    judge = Judge(background, still, 1.0, ball_px)
    for press in presses.presses:
        look = judge.look(press.image)
        x, y, radius = np.array(press.label) / 2
        assert np.hypot(look.circle[0] - x, look.circle[1] - y) < 0.2 * radius, look.reason
        judge.accept()


def test_the_same_place_again_is_rejected_with_the_reason(guide, see, press):
    see(times=USUAL_FRAMES)
    for seed in (1, 2):
        see(press(3, 2, seed=seed).image, 8)
        see()
    facts = guide.facts()
    assert facts["count"] == 1
    (rejected,) = facts["rejected"]
    assert "before" in rejected[-1]


def test_presses_fill_the_coverage_and_move_the_target_away(guide, see, press):
    see(times=USUAL_FRAMES)
    assert len(guide.places) == NEXT_PLACES
    shares, targets = [], set()
    for x_mm, y_mm in ((0, 0), (6, 4), (-6, -4), (6, -4), (-6, 4)):
        see(press(x_mm, y_mm).image, 8)
        see()
        shares.append(guide.facts()["coverage"]["share"])
        targets.add((guide.target.x_px, guide.target.y_px))
        places = [(x, y) for x, y, _, _ in guide.facts()["places"]]
        assert len(set(places)) == len(places) == NEXT_PLACES
        assert places[0] == (guide.target.x_px, guide.target.y_px)
    assert shares == sorted(shares)
    assert shares[-1] > shares[0] > 0
    assert len(targets) > 3
    coverage = guide.facts()["coverage"]
    assert sum(coverage["directions"]) == pytest.approx(8 * coverage["share"] * len(coverage["directions"]))
    made = guide.presses()
    assert len(made.presses) == LEAST
    assert (made.mm_per_px, made.make) == (guide.settings.mm_per_px, "gelsight-mini")


def test_presses_that_show_little_are_never_enough(guide, see, press, monkeypatch):
    see(times=USUAL_FRAMES)
    guide.wanted = 3
    for x_mm in (-2, 0, 2):
        see(press(x_mm, 0).image, 8)
        see()
    facts = guide.facts()
    assert (facts["count"], facts["enough"], facts["coverage"]["level"]) == (3, False, "poor")
    assert "can fit" not in guide.hint
    monkeypatch.setattr(module, "COVERED", replace(module.COVERED, fair=100 * facts["coverage"]["share"]))
    see()
    assert guide.facts()["enough"]
    assert "can fit" in guide.hint


def test_too_few_presses_cannot_be_fitted(guide, see):
    see(times=USUAL_FRAMES)
    with pytest.raises(GelformError, match="Press again"):
        guide.presses()


def test_a_dark_surround_is_named_with_the_crop_that_fits(guide, see, sensor):
    rest = np.asarray(simulate_background(sensor, np.random.default_rng(1)), np.uint8)
    rest[:, :30] = 2
    see(rest, USUAL_FRAMES)
    assert guide.step == "press"
    see(rest)
    assert "outside the gel" in guide.hint
    assert re.search(r"--crop 3\d,0,\d+,\d+ of gelform calibrate.* Press the ball at 1", guide.hint)


def test_a_background_that_something_touches_is_refused_while_it_does(guide, monkeypatch):
    """As far as the make's starter tells; a gel that always looks so is damaged, and can be calibrated."""
    layout, rng = LAYOUTS["three-edges"], np.random.default_rng(4)
    monkeypatch.setattr(module, "starter_for", lambda *_: load_starter("simulated-three-edges"))
    touched = np.asarray(simulate_press(layout, Ball(2.5), depth_mm=0.5, rng=rng).image)
    rest = np.asarray(simulate_background(layout, rng))
    for images, step in (([touched], "background"), ([touched, rest], "press"), ([touched] * 6, "press")):
        one = Guide(guide.settings, 5.0)
        for k, image in enumerate(images):
            for _ in range(USUAL_FRAMES):
                one.look_at(Frame(image, 0.0, 0, k))
            assert one.step == ("background" if k < len(images) - 1 else step)
            assert one.step == "press" or "Something seems to touch the gel" in one.hint


@pytest.fixture
def made(presses, calibration, monkeypatch, tmp_path):
    """Makes the guided calibration of the shared presses; calibration itself was done once for all."""
    monkeypatch.setattr(module, "calibrate", lambda *_, **__: calibration)
    return lambda: module.calibrate_guided(presses, tmp_path)


def test_its_folder_has_the_calibration_and_the_library_once_it_is_kept(made, library, presses):
    found = made()
    assert "<html" in found.report_file.read_text(encoding="utf-8")
    assert len(gelform.read_presses(found.folder).presses) == len(presses.presses)
    assert not list(library.glob("*"))
    path, said = found.keep()
    assert [path] == list(library.iterdir())
    assert "The library has it too" in said
    saved = gelform.load_calibration(found.folder / "calibration.npz")
    assert saved.digest == gelform.load_calibration(path).digest == found.calibration.digest


def test_its_folder_says_what_is_known_of_the_sensor(presses, calibration, monkeypatch, tmp_path):
    monkeypatch.setattr(module, "calibrate", lambda *_, **__: calibration)
    geometry = replace(presses.geometry, gel_thickness_mm=4.2)
    known = {"make": "gelsight-mini", "camera": {"exposure": 50.0}, "mm_per_px_sigma": 0.001}
    made = module.calibrate_guided(replace(presses, geometry=geometry, **known), tmp_path)
    again = gelform.read_presses(made.folder)
    assert {name: getattr(again, name) for name in known} == known
    assert again.geometry.gel_thickness_mm == 4.2


def test_its_figures_are_those_of_the_report(made, library, presses):
    found = made()
    assert found.report["accepted"] + len(found.report["rejected"]) == len(presses.presses)
    assert found.report["level"] in ("good", "fair", "poor")
    (seen,) = [check["value"] for check in found.report["checks"] if "slope directions" in check["label"]]
    assert seen == pytest.approx(100 * found.covered.fraction), "one figure"
    assert 1 <= len(found.places) <= 3
    page = found.report_file.read_text(encoding="utf-8")
    assert all(f"{place.x_px:.0f}, {place.y_px:.0f}" in page for place in found.places), "its places 1, 2, 3"


def test_a_library_that_cannot_be_written_is_said(made, library):
    library.write_text("a file where the folder should be")
    found = made()
    path, said = found.keep()
    assert path == found.folder / "calibration.npz"
    assert "The library does not have it: Expected a folder for the library" in said
