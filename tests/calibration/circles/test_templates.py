"""Templates of a ball: presses whose imprint is as bright on one side as on the other, and frames without one."""

import csv
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles import templates
from gelform.calibration.circles.find import MIN_EVIDENCE, ContactCircle, marked_contact, why_no_contact
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.circles.templates import find_by_templates

SHAPE, RADIUS = (120, 160), 14.0
CIRCLES = [(40.0, 35.0), (110.0, 80.0), (75.0, 50.0), (120.0, 30.0)]


def even_press(name, x, y, rng, strength=0.3):
    """A press that is brighter all around in red, and odd by a little in blue, in noise."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rho = np.hypot(cols - x, rows - y) / RADIUS
    inside = np.clip((1 - rho) / 0.1, 0, 1)
    change = np.zeros((*SHAPE, 3), np.float32)
    change[..., 0] = strength * inside * rho**2
    change[..., 2] = 0.2 * strength * inside * (cols - x) / RADIUS
    change += rng.normal(0, 0.01, change.shape).astype(np.float32)
    return PreparedPress(name, change, np.linalg.norm(change, axis=-1).astype(np.float32), 30.0)


@pytest.fixture(scope="module")
def even():
    rng = np.random.default_rng(4)
    return [even_press(f"{k}.png", *center, rng) for k, center in enumerate(CIRCLES)]


def test_a_press_that_is_brighter_all_around_is_found(even):
    found = find_contacts(even)
    for contact, (x, y) in zip(found, CIRCLES):
        assert contact.antisymmetry < 0.3, "the first finder does not see it"
        assert (contact.x_px, contact.y_px) == pytest.approx((x, y), abs=0.15 * RADIUS)
        assert contact.radius_px == pytest.approx(RADIUS, rel=0.2)
        assert contact.evidence > 3 * MIN_EVIDENCE
        assert why_no_contact(contact) is None


def test_a_circle_that_is_known_stays_and_noise_is_no_ball(even):
    rng = np.random.default_rng(5)
    nothing = even_press("nothing", 0.0, 0.0, rng, strength=0.0)
    known = [(*center, RADIUS) for center in CIRCLES]
    assert find_by_templates(even, known) == {}
    ((index, (_, evidence)),) = find_by_templates([*even, nothing], [*known, None]).items()
    assert index == 4
    assert evidence < MIN_EVIDENCE
    (last,) = find_contacts([nothing])
    assert why_no_contact(last) is not None


def test_what_most_frames_show_is_no_ball(monkeypatch):
    """A disc at one place of every frame, beside three firm presses and a light one."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    speck = 0.05 * np.clip((1 - np.hypot(cols - 20, rows - 95) / RADIUS) / 0.1, 0, 1)[..., None]
    rng = np.random.default_rng(4)
    strengths = (0.4, 0.4, 0.4, 0.08)
    presses = [even_press("a", *center, rng, strength) for center, strength in zip(CIRCLES, strengths)]
    framed = [replace(press, color_change=press.color_change + np.float32(speck)) for press in presses]

    def places():
        found = find_by_templates(framed, [None] * 4)
        return [np.hypot(*np.subtract(found[k][0][:2], center)) < 4 for k, center in enumerate(CIRCLES)]

    assert places() == [True] * 4
    monkeypatch.setattr(templates, "COMMON", 0.0)
    assert not places()[3], "without the noise of the place, the light press is taken for the disc"


def test_a_stage_s_center_stays_and_templates_give_its_radius(even):
    """About the center alone, another press's edge would be taken for the rim."""
    x, y = CIRCLES[0]
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ring = (np.hypot(cols - x, rows - y) < 45)[..., None] * np.float32([0.0, 0.35, 0.0])
    first = even[0].color_change + ring.astype(np.float32)
    size = np.linalg.norm(first - np.median(first, axis=(0, 1)), axis=-1).astype(np.float32)
    staged = replace(even[0], color_change=first, size=size, mark=(x + 1, y - 1, None))
    contact = find_contacts([staged, *even[1:]])[0]
    assert contact.marked
    assert (contact.x_px, contact.y_px) == (x + 1, y - 1)
    assert contact.radius_px == pytest.approx(RADIUS, rel=0.25)


@pytest.mark.parametrize(
    ("antisymmetry", "apart", "taken"), [(0.1, 40.0, True), (0.6, 3.0, True), (0.6, 40.0, False)]
)
def test_a_circle_by_hand_is_taken_unless_a_clear_ball_is_elsewhere(even, antisymmetry, apart, taken):
    press, (x, y) = even[0], CIRCLES[0]
    clear = ContactCircle(x + apart, y, RADIUS, antisymmetry, 5.0)
    contact = marked_contact(clear, press.size, x, y, RADIUS)
    assert contact.marked == taken
    assert (contact.x_px, contact.y_px) == ((x, y) if taken else (x + apart, y))
    if taken:
        assert contact.radius_px == pytest.approx(RADIUS, rel=0.15)
        assert why_no_contact(contact) is None


@pytest.mark.slow
def test_presses_of_home_made_sensors_are_found_without_their_circles(data):
    folder = data / "homemade-even" / "a"
    presses = gelform.read_presses(folder)
    with (folder / "presses.csv").open(encoding="utf-8") as file:
        circles = {row["image"]: [float(v) for v in list(row.values())[2:5]] for row in csv.DictReader(file)}
    bare = tuple(replace(press, label=None) for press in presses.presses)
    for press, contact in zip(bare, find_contacts(prepare(replace(presses, presses=bare)))):
        x, y, radius = circles[press.name]
        assert np.hypot(contact.x_px - x, contact.y_px - y) < 0.2 * radius  # the circles are by eye
