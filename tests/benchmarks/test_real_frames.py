"""The benchmark on real frames counts what it says, its quick run works, and the pages quote its results alone."""

import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

import gelform
from edges_of_cube import Edge
from gelform.depth.contact import contacts_from_mask
from gelform.simulate import LAYOUTS, simulate_ball_presses, simulate_press
from presses import unlabeled
from real_frames import following, page
from real_frames.balls import stated
from real_frames.beyond import below, on_balls, steeper
from real_frames.contacts import blended, contacts, counted, rest
from real_frames.edges import border_off, judged, summary
from real_frames.faces import outlined
from real_frames.faults import exposure, older_halves, tears, torn
from real_frames.sets import MINI_MM_PER_PX, Run
from real_frames.simulated import TwoBalls, label_over
from report import RESULTS

FIGURES = json.loads((RESULTS / "real_frames.json").read_text(encoding="utf-8"))
TEXTS = {name: (page.ROOT / name).read_text(encoding="utf-8") for name in page.PAGES}


@dataclass
class Found:
    """A result with these discs (x, y, radius, depth) as contacts."""

    discs: list

    shape = (60, 80)

    def __post_init__(self):
        y, x = np.mgrid[: self.shape[0], : self.shape[1]]
        depth = np.zeros(self.shape)
        for cx, cy, radius, depth_mm in self.discs:
            depth[np.hypot(x - cx, y - cy) < radius] = depth_mm
        self.contacts, self.contact_labels = contacts_from_mask(depth != 0, depth, mm_per_px=0.1)


def test_contacts_are_counted():
    ball, speck, hollow = (40, 30, 10, 0.5), (5, 5, 3, 0.1), (70, 50, 3, -0.1)
    results = [Found(one) for one in ([], [ball], [speck], [ball, speck, hollow])]
    found = counted(results, [(40, 30, 12)] * 4)
    ratio, beyond = found.pop("radius over circle"), found.pop("beyond two radii %")
    area = {one: np.count_nonzero(Found([one]).contact_labels) for one in (ball, speck, hollow)}
    far = 2 * area[speck] + area[hollow]
    assert beyond == pytest.approx(100 * far / (far + 2 * area[ball]))
    # The speck alone is one contact, but not on the ball.
    assert list(found.values()) == [4, 50, 25, 0.5, 1, 25]
    assert ratio == pytest.approx(10 / 12, abs=0.02)
    assert counted(results)["one, on the ball %"] is None


def test_faint_presses_are_as_noisy_as_others():
    rng, rest = np.random.default_rng(0), np.full((60, 80, 3), 100.0)
    calibration = SimpleNamespace(background=rest, settings=SimpleNamespace(image_noise=(2.0, 2.0, 2.0)))
    found = blended(calibration, rest + 50 + rng.normal(0, 2, rest.shape), 0.12, rng)
    assert found.mean() == pytest.approx(106, abs=0.1)
    assert found.std() == pytest.approx(2, rel=0.05)


def test_outlines_of_faces_are_compared():
    truth = np.zeros((40, 50), bool)
    truth[10:30, 10:30] = True
    contact = truth.copy()
    contact[15:20, 15:25] = contact[10:30, 10:12] = False  # a hole, and a strip that is open at the rim
    contact[12:14, 40:45] = True
    covered, outside, overlap, holes = outlined(contact, truth, 4)
    assert (covered, holes) == (pytest.approx(310 / 400), 1)
    assert (outside, overlap) == (pytest.approx(10 / 320), pytest.approx(310 / 410))
    assert outlined(contact, truth, 4, inner=truth)[3] == 2


def test_a_circle_that_is_unsure_or_outside_is_not_judged():
    results = [Found([(40, 30, 10, 0.5)])] * 3
    assert counted(results, [None, (40, 30, 12), (40, 60, 12)])["one, on the ball %"] == 100


def test_torn_frames_are_counted():
    rest_image = np.random.default_rng(0).integers(100, 120, (96, 128, 3), np.uint8)
    gray = rest_image.copy()
    gray[48:] = 128
    sound = rest_image.copy()
    sound[40, 60] += 1
    expected = {"frames": 3, "torn": 1, "percent": pytest.approx(100 / 3)}
    assert torn(rest_image, [sound, gray, sound]) == expected


def test_faces_of_a_cube_are_judged_by_their_sigma():
    shape, (left, right) = (40, 60), (np.s_[:, 10:28], np.s_[:, 33:50])
    faces, gradients = np.zeros((2, *shape), bool), np.zeros((*shape, 2))
    faces[0][left] = faces[1][right] = True
    gradients[left], gradients[right] = (0.5, 9), (-0.5, 9)  # the slope along the edge is not judged
    slopes, true = np.array([0.5, 0.5]), np.array([[1.0, 0], [-1, 0]])
    edge = Edge(np.array([1.0, 0]), np.array([30, 20]), 38.0, faces, slopes, 0.0, true)
    sigma, confidence = np.full((*shape, 2), 0.1), np.zeros(shape)
    sigma[left] = (0.26, 0)  # half is missing: 1.9 sigma
    confidence[right] = 0.4
    flat = SimpleNamespace(
        gradients=gradients, gradients_sigma=sigma, confidence=confidence, depth_mm=np.zeros(shape),
        depth_sigma_mm=np.full(shape, 0.4), known=np.ones(shape, bool),
    )  # fmt: skip
    found = summary([judged(edge, flat)] * 2)
    assert (found["frames"], found["angle of faces, deg"]) == (2, pytest.approx(180 - 53.13, abs=0.01))
    assert found["within 2 sigma, %"] == pytest.approx(100 * 18 / 35)
    assert found["confidence > 0.3, %"] == pytest.approx(100 * 17 / 35)
    # Of faces of 18 and 17 px.
    assert found["crest too low by, um"] == pytest.approx(1e3 * 19.5 * MINI_MM_PER_PX)
    assert found["crest within 2 depth sigma, %"] == 0
    assert summary([]) == {"frames": 0}


def test_depth_at_the_border_is_judged_far_from_the_faces():
    shape = (40, 100)
    touched = np.zeros(shape, bool)
    touched[:, :50] = True  # 39 px before the last 12 columns, of which the first is too near
    depth = np.full(shape, 0.5)
    depth[:, -4:] = -1.5
    known = np.ones(shape, bool)
    known[:10] = False
    result = SimpleNamespace(depth_mm=depth, depth_sigma_mm=np.full(shape, 0.5), known=known)
    for end, columns in ((50, 7), (30, 8)):
        touched[:, end:] = False
        off = border_off(touched, result)
        assert np.array_equal(np.unique(off, return_counts=True), [[1, 3], [30 * columns, 30 * 4]])


def test_deviations_are_judged_off_the_contact_beside_it_and_in_it():
    shape, pitch = (100, 120), 0.1
    y, x = np.mgrid[: shape[0], : shape[1]]
    away = np.hypot(x - 60, y - 50)
    press = SimpleNamespace(label=(60, 50, 14), ball_diameter_mm=8.0)
    slopes = np.dstack([60 - x, 50 - y]) / np.sqrt(np.maximum(40.0**2 - away**2, 1))[..., None]
    result = SimpleNamespace(
        shape=shape, mm_per_px=pitch, gradients=1.3 * slopes,
        gradients_sigma=np.full((*shape, 2), 0.05), confidence=np.where(x < 60, 1.0, 0.0),
        depth_mm=np.where(away <= 35, 99.0, np.where(away < 42, 0.5, -0.05)), depth_sigma_mm=np.full(shape, 0.1),
        known=y < 95,
    )  # fmt: skip
    result.depth_mm[:5] = 0.15
    found = stated(press, result, 0.8)
    far = (away > 35) & result.known
    beside = far & (away < 42)
    top, border = far & (y < 5), far & ((y < 5) | (x < 5) | (x >= 115))
    assert found["far2 %"] == pytest.approx(100 * (1 - beside.sum() / far.sum()))
    assert found["far1 %"] == pytest.approx(100 * (1 - (top | beside).sum() / far.sum()))
    assert (found["ring1 %"], found["ring2 %"]) == (0, pytest.approx(0))
    assert found["border1 %"] == pytest.approx(100 * (1 - top.sum() / border.sum()))
    assert found["sure %"] == pytest.approx(50, abs=4)
    assert found["slopes1 %"] == pytest.approx(70, abs=2)
    assert found["slopes2 %"] == 100


def test_the_pages_show_deviations_once_they_are_recorded():
    figures = json.loads(json.dumps(FIGURES))
    for row in figures["balls"]["errors"].values():
        row |= {"far1 %": 66.4, "far2 %": 95.2}
    shown = page.sensors(figures)
    assert shown.count("66 %, 95 %") == shown.count("GelS") + shown.count("DIGIT") == 6
    del figures["balls"]["errors"]["mini-d"]["far1 %"]
    assert "66 %" not in page.sensors(figures)


def test_a_contact_counts_as_found_if_it_covers_half():
    result = Found([(40, 30, 10, 0.5), (10, 10, 5, 0.2)])
    y, x = np.mgrid[:60, :80]
    big, small = np.hypot(x - 40, y - 30) < 10, np.hypot(x - 10, y - 10) < 5
    expected = [result.contact_labels[10, 10], result.contact_labels[30, 40]]
    assert [label_over(result, one) for one in (small, big)] == expected
    assert label_over(result, np.hypot(x - 40, y - 30) < 16) == 0
    assert label_over(Found([]), big) == 0


@pytest.mark.slow
def test_two_balls_touch_a_gap_apart():
    sensor, rng = LAYOUTS["ring-120"], np.random.default_rng(0)
    for apart, contacts_of_both in ((0.0, 1), (2.6, 2)):
        press = simulate_press(sensor, TwoBalls(1.5, apart), depth_mm=0.3, rng=rng, oversample=1)
        labels, count = ndimage.label(press.contact)
        assert count == contacts_of_both
        if count == 2:
            (left, right) = (np.argwhere(labels == k)[:, 1] for k in (1, 2))
            centers = abs(left.mean() - right.mean()) * sensor.mm_per_px
            assert centers == pytest.approx(apart, abs=0.1)


@pytest.fixture
def quick(data):
    """A run on twelve presses of a real set."""
    run = Run(("mini-ball",), quick=True)
    twelve = run.presses("mini-ball").subset(range(0, 67, 6))
    run.kept("mini-ball", lambda: gelform.calibrate(unlabeled(twelve)))
    return run


@pytest.mark.slow
def test_quick_parts_run_on_one_set(quick):
    found = {part.__name__: part(quick) for part in (contacts, rest, exposure, tears)}
    assert found["contacts"]["balls"]["mini-ball"]["frames"] == 12
    assert found["contacts"]["balls"]["mini-ball"]["none %"] == 0
    assert found["rest"]["mini-ball, background and noise"]["frames"] == 4
    moved = found["exposure"]["mini-ball"]
    assert 0 < moved["moved, median"] < moved["moved, max"] < moved["largest, max"]
    assert found["tears"]["sound: mini-ball"] == {"frames": 12, "torn": 0, "percent": 0}


def test_a_calibration_is_made_once_and_kept_for_later_runs(tmp_path):
    made = []

    def make():
        made.append(1)
        return {"made": len(made)}

    first, again, alone = Run(cache=tmp_path), Run(cache=tmp_path), Run()
    assert [run.kept("a set", make)["made"] for run in (first, first, again, alone, alone)] == [1, 1, 1, 2, 2]
    (kept,) = tmp_path.iterdir()
    kept.rename(tmp_path / "of other sources a set.pickle")
    assert Run(cache=tmp_path).kept("a set", make)["made"] == 3


def test_halves_are_of_two_presses_with_a_contact_at_the_seam(data):
    run = Run()
    presses, halves = run.presses("mini-ball").presses, older_halves(run)
    assert 16 <= len(halves) < len(presses)
    for half in halves:
        above, below = (
            [k for k, one in enumerate(presses) if np.array_equal(one.image[rows], half[rows])]
            for rows in (np.s_[:120], np.s_[120:])
        )
        assert above[0] == below[0] + 1
        labels = [presses[k].label for k in (above[0], below[0])]
        assert any(abs(y - 120) < radius for _, y, radius in labels)


@pytest.mark.parametrize("name", page.PAGES)
def test_pages_quote_the_recorded_figures(name):
    """`python benchmarks/real_frames.py --pages` writes them."""
    assert page.filled(TEXTS[name], FIGURES) == TEXTS[name]


def test_every_block_stands_in_a_page():
    quoted = {found[2] for text in TEXTS.values() for found in page.BLOCK.finditer(text)}
    assert quoted == set(page.BLOCKS)


def test_another_figure_is_noticed():
    text = TEXTS["docs/accuracy.md"]
    changed = json.loads(json.dumps(FIGURES))
    changed["contacts"]["balls"]["mini-ball"]["exactly one %"] += 1
    assert page.filled(text, changed) != text
    assert page.filled(page.filled(text, changed), FIGURES) == text


@pytest.mark.slow
def test_slopes_beyond_the_training_are_judged_alone(sensor, presses, calibration):
    limit, rng = 0.25, np.random.default_rng(4)
    gentle = below(presses, limit)
    shown = [one.slope_sigma.shown[1] for one in (gentle, calibration)]
    assert shown[0] < 1.2 * limit < 0.4 < shown[1]
    new = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=12, rng=rng, oversample=1)
    whole = [one for one in new.presses if all(40 < c < n - 40 for c, n in zip(one.center_px, (176, 132)))]
    known = [
        SimpleNamespace(
            image=p.image, label=(*p.center_px, p.contact_radius_px), ball_diameter_mm=p.ball_diameter_mm
        )
        for p in whole
    ]
    counts = [steeper(calibration, known, 0.9, least)["pixels"] for least in (0, limit, 2)]
    assert counts[0] > counts[1] > counts[2] == 0
    own = on_balls(calibration, known, 0.9)
    assert 60 < own["slopes within 1 sigma, %"] < 98  # more than at the border, where one law holds too
    assert own["sure inside 0.6, %"] > 80
    assert own["caps within 1 depth sigma, %"] > 50
    assert own["caps within 2 sigma of the difference, %"] > 50
    doubled = [SimpleNamespace(**vars(one) | {"ball_diameter_mm": 2 * one.ball_diameter_mm}) for one in known]
    wrong = on_balls(calibration, doubled, 0.9)
    assert wrong["slopes within 1 sigma, %"] < 50
    assert wrong["caps within 1 depth sigma, %"] < 30
    assert wrong["caps within 2 sigma of the difference, %"] < 30


@pytest.mark.slow
def test_a_stream_s_memory_is_judged_against_the_truth_and_against_none(quick, monkeypatch):
    for name, value in (("STEP_S", 5.0), ("PRESSES", 1), ("DRIFTING", 1), ("DRIFT_S", 30.0)):
        monkeypatch.setattr(following, name, value)
    pressed, real, drift = following.following(quick).values()
    for row in pressed.values():
        assert row["held, memory"] == pytest.approx(row["held, no memory"], rel=0.5)
        assert 0 < row["held, no memory"] < 10
    assert 0 < real["mini-ball"]["held, memory"] < 2
    assert drift["LEDs"]["followed"] < 0.3 * drift["LEDs"]["not followed"]
