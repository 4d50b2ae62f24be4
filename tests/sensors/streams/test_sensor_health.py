"""Faults of a sensor: a repeated image, the light, settings of the camera, marks on the gel, another or a moved gel.

The background image over minutes: it follows LEDs and gel, but no slow press; touches do not distort the smooth light.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.guide import TakenPresses
from gelform.errors import Finding, SourceLostError
from gelform.image.light import block_means, light_at_rest, lit
from gelform.sensors import SensorSettings
from gelform.sensors.streams.memory import Memory
from gelform.sensors.streams.sensor_health import (
    AFTER_S,
    MEAN_IMAGE_S,
    BackgroundDrift,
    DriftEvidence,
    Frozen,
    Marks,
    SameGel,
    Touched,
    camera_findings,
    light_findings,
    light_from_outside,
)
from gelform.simulate import simulate_background
from gelform.simulate.sensor import Coating
from live_waiting import until
from made.sources import ImageSource
from stream.sensor_faults import CHANGES, ONSET_S, Gel, dust, moved, scratch, tear
from stream.slow_gel import SlowGel, Touch

SHAPE = (96, 128)
IMAGE = np.random.default_rng(0).integers(0, 255, (40, 50, 3), dtype=np.uint8)


def names(images, rate_hz):
    frozen = Frozen()
    return [bool(frozen(image, index / rate_hz)) for index, image in enumerate(images)]


def other(row):
    image = IMAGE.copy()
    image[row, 3, 1] ^= 1
    return image


def test_one_image_for_a_while_is_frozen_until_the_next_and_noise_is_life():
    assert not any(names([IMAGE if i % 2 else other(17) for i in range(40)], 25))
    assert not any(names([image for row in range(30) for image in (other(row), other(row).copy())], 25))
    found = names([other(3)] + [IMAGE.copy()] * 20, 25)
    assert found.index(True) == 8  # 0.25 s after the first of them
    assert all(found[8:])
    frozen = Frozen()
    for index in range(20):
        found = frozen(IMAGE, index / 10)
    assert found[0].figure == 1.9
    assert frozen(other(5), 2.0) == ()


def named(gains):
    return {finding.name: finding.figure for finding in light_findings(np.array(gains))}


def test_light_that_changes_is_brightness_or_color():
    assert named([1.0, 1.02, 0.99]) == {}
    assert named([0.8, 0.8, 0.8]) == {"brightness_shift": pytest.approx(-0.2)}
    assert "(R +0.0 %, G +6.0 %, B -1.0 %)" in light_findings(np.array([1.0, 1.06, 0.99]))[0].message
    assert named([1.0, 1.06, 1.0]) == {"color_shift": pytest.approx(0.06)}


def levels(shape):
    """Levels (h, w, 3) of a gel at rest under uneven light."""
    y, x = np.mgrid[: shape[0], : shape[1]] / shape[1]
    return np.stack([40 + 90 * x, 120 - 60 * y, 60 + 60 * x * y], axis=-1).astype(np.float32)


def evidence(image, start, *, touched=None, contact=None, different=0.0):
    """Evidence of an image against a start, in the same light; touched nowhere by default."""
    image, start = image.astype(np.float32), start.astype(np.float32)
    touched, contact = (np.zeros(start.shape[:2], bool) if one is None else one for one in (touched, contact))
    return DriftEvidence(image, start, start, touched, contact, different)


def outside(now, contact=None):
    """The findings of light from outside in an image."""
    return light_from_outside(evidence(now, levels(SHAPE), contact=contact))


def noise(seed=0):
    return np.random.default_rng(seed).normal(0, 0.5, (*SHAPE, 3))


def test_light_from_outside_is_added_in_every_channel_off_contact():
    """Not the sensor's own light, that of one channel, or what touches; a little is removed, and not worth a word."""
    start, contact = levels(SHAPE), np.zeros(SHAPE, bool)
    (found,) = outside(0.97 * start + 10 + noise())
    assert found.name == "room_light"
    assert found.figure == pytest.approx(10, abs=1.5)
    for now in (start + 2, 0.75 * start, start, 1.3 * start, start + np.array([15, 0, 0])):
        assert outside(now + noise()) == ()
    now = start + noise()
    now[:, 40:] += 30
    contact[:, 40:] = True
    assert outside(now, contact) == outside(now, np.ones(SHAPE, bool)) == ()


def camera(serial=None, **settings):
    return SimpleNamespace(serial=serial, settings=settings)


def taken_with(calibration, **settings):
    return replace(calibration, settings={**calibration.settings, "camera": settings})


def source_of(images, settings, **how):
    source = ImageSource(images, **how)
    source.settings = settings
    return source


def mismatches(result):
    return [one for one in result.health if one.name == "settings_mismatch"]


def test_another_unit_is_named_and_the_same_or_unknown_settings_are_none(calibration):
    known, unknown = (replace(calibration, serial=serial) for serial in ("D1", None))
    (finding,) = camera_findings(known, camera("D2"))
    assert finding.name == "other_camera"
    assert "serial is D2, but the calibration is of D1" in finding.message
    exposed = taken_with(calibration, exposure=100.0)
    for one, used in (
        *((known, camera(serial)) for serial in ("D1", None)),
        (unknown, camera("D2")),
        *((exposed, used) for used in (camera(exposure=100.0), camera())),
        (calibration, camera(exposure=100.0)),
    ):
        assert camera_findings(one, used) == ()


def test_a_camera_that_forgot_its_settings_when_it_was_unplugged_is_found(calibration, at_rest):
    first = source_of(at_rest, {"exposure": 100.0, "gain": 1.0}, fails=SourceLostError("unplugged"))
    plugged = [first, source_of(at_rest, {"exposure": 250.0, "gain": 1.0})]
    calibration = taken_with(calibration, exposure=100.0, gain=1.0)
    with gelform.stream(lambda: plugged.pop(0), calibration) as stream:
        assert mismatches(stream.newest(timeout_s=60).result) == []
        first.count = 0  # it ends, and fails
        (finding,) = until(lambda: mismatches(stream.newest(timeout_s=60).result))
        assert finding.figure == 1
        assert "exposure 250.0 instead of 100.0" in finding.message


@pytest.mark.slow
@pytest.mark.parametrize(("exposure", "found"), [(120.0, 0), (180.0, 1)])
def test_from_the_press_folder_to_the_stream(pressed_folder, simulated, at_rest, exposure, found):
    """What `gelform record --presses` writes is what the stream compares with."""
    calibration = gelform.load_calibration(pressed_folder)
    assert calibration.serial == "D7"
    used = {"width": 176, "height": 132, "exposure": exposure, "gain": 3.0, "led_level": 15.0}
    source = source_of(at_rest, used, live=False, count=1)
    source.serial = "D7"
    (result,) = gelform.stream(source, calibration)
    assert len(mismatches(result)) == found
    assert "other_camera" not in [one.name for one in result.health]


@pytest.fixture(scope="module")
def pressed_folder(simulated, tmp_path_factory):
    """A calibration file of presses taken one by one with a camera whose settings are known."""
    folder = tmp_path_factory.mktemp("settings") / "presses"
    camera = {"width": 176, "height": 132, "exposure": 120.0, "gain": 3.0, "led_level": 15.0}
    settings = SensorSettings("made", simulated.sensor.mm_per_px, serial="D7", camera=camera)
    taken = TakenPresses(folder, settings, simulated.presses[0].ball_diameter_mm)
    taken.take_background([simulated.background.round().astype("uint8")] * 3)
    for press in simulated.presses[:8]:
        taken.take_press(press.image)
    calibration = gelform.calibrate(gelform.read_presses(folder), color_model="lambertian")
    calibration.save(folder.parent / "made.npz")
    return folder.parent / "made.npz"


@pytest.mark.slow
@pytest.mark.parametrize("fault", [*CHANGES, "other_gel", "frozen", "torn"])
def test_each_fault_is_named(findings, fault):
    found = findings(fault)
    assert fault in found
    assert found[fault] >= (0 if fault == "other_gel" else ONSET_S)


def test_a_sound_gel_has_no_findings(findings):
    assert findings(None) == {}


MARKED_SHAPE = (160, 200)
REST = np.full((*MARKED_SHAPE, 3), 100.0)


def marks_found(images, contact=None):
    marks, rng = Marks(), np.random.default_rng(0)
    for image in images:
        found = marks(evidence(image + rng.normal(0, 0.2, image.shape), REST, contact=contact))
    return found


def marks_in(images, contact=None):
    return [finding.name for finding in marks_found(images, contact)]


@pytest.mark.parametrize("fault", [scratch, dust, tear])
def test_each_is_named_when_it_stays(fault):
    marked = fault(REST, np.random.default_rng(8))
    assert marks_in([REST] * 5) == marks_in([REST, marked, marked]) == []
    assert marks_in([REST, marked, marked, marked]) == [fault.__name__]


@pytest.mark.parametrize("turn", [1, -1], ids=["the smaller first", "the larger first"])
def test_of_several_marks_the_largest_is_said(turn):
    y, x = np.mgrid[: MARKED_SHAPE[0], : MARKED_SHAPE[1]]
    spots = (np.hypot(x - 50, y - 40) < 3) | (np.hypot(x - 140, y - 110) < 5)
    (found,) = marks_found([np.where(spots[..., None], 80.0, REST)[::turn]] * 4)
    assert found.name == "dust"
    assert found.figure == pytest.approx(10, abs=2)


def test_what_comes_and_goes_or_rests_there_is_no_mark():
    """A scratch within a wide contact is the relief of what touches.

    A body's contact ends in thin parts, farther from where it is wide than a mark's surroundings.
    """
    spot, groove = (fault(REST, np.random.default_rng(8)) for fault in (dust, scratch))
    assert marks_in([spot, spot, REST, spot, spot]) == []
    assert marks_in([groove] * 4, contact=np.ones(MARKED_SHAPE, bool)) == []
    y, x = np.nonzero(groove.mean(axis=-1) != 100)
    body = np.zeros(MARKED_SHAPE, bool)
    body[:, : x.min() - 40] = True
    body[y.min() : y.max() + 1 : 3, x.min() - 40 : x.min() + 1] = True  # narrow tongues that reach it
    assert marks_in([groove] * 4, contact=np.zeros(MARKED_SHAPE, bool)) == ["scratch"]
    assert marks_in([groove] * 4, contact=body) == []
    ribs = np.indices(MARKED_SHAPE)[0] % 8 < 6  # an object that is nowhere wide
    assert marks_in([groove] * 4, contact=ribs) == []


def test_a_short_groove_is_a_scratch_and_a_short_dark_spot_is_none():
    """Both 20 px long and about 10 wide: the groove is bright on one side and dark on the other, blue in its middle."""
    y, x = np.mgrid[: MARKED_SHAPE[0], : MARKED_SHAPE[1]]
    along, across = np.clip((10 - np.abs(x - 90)) / 2, 0, 1)[..., None], y - 70
    middle = np.exp(-((across / 1.6) ** 2) / 2)
    sides = across / 1.6 * middle
    groove = along * np.stack([0.3 * sides, 0.3 * sides, -0.1 * middle], axis=-1)
    spot = -0.2 * along * np.exp(-((across / 2.2) ** 4) / 10)[..., None]
    for name, shape in (("scratch", groove), ("dust", spot)):
        assert marks_in([REST * (1 + shape)] * 4) == [name]


@pytest.fixture(scope="module")
def gel(sensor):
    return Gel.drawn(sensor, np.random.default_rng(1))


def looks(start, images, *, touched=0.0, different=0.0):
    same_gel, somewhere = SameGel(start.astype(np.float32)), np.zeros(start.shape[:2], bool)
    somewhere[: int(touched * len(somewhere))] = True
    return [same_gel(evidence(image, start, touched=somewhere, different=different)) for image in images]


def noisy(gel):
    rng = np.random.default_rng(5)
    return [gel.rest + rng.normal(0, 0.2, gel.rest.shape) for _ in range(4)]


def test_the_same_gel_in_its_place_and_one_touched_all_over(gel):
    assert looks(gel.rest, noisy(gel)) == [()] * 4
    image = moved(gel.rest, np.random.default_rng(3))
    assert looks(gel.rest, [image] * 3, touched=0.9) == [()] * 3


def test_a_camera_that_moved_and_another_gel(gel, sensor):
    image = moved(gel.rest, np.random.default_rng(3))
    found = looks(gel.rest, [image])[0]
    assert found[0].name == "camera_moved"
    assert 1 <= found[0].figure <= 4.5
    found = looks(gel.rest, noisy(Gel.drawn(sensor, np.random.default_rng(2))))
    assert (found[0], found[-1][0].name) == ((), "other_gel")
    found = looks(gel.rest, noisy(gel), different=1.0)
    assert (found[1], found[3][0].name) == ((), "other_gel")


def test_a_smooth_gel_in_place_of_a_rough_one(sensor):
    """It promises a correlation of a tenth: little, but the same gel would show it."""
    coatings = Coating(roughness=0.009, seed=1), Coating(roughness=0.003, seed=2)
    coated = (replace(sensor, coating=one) for one in coatings)
    rough, smooth = (simulate_background(one, None, quantise=False) for one in coated)
    rng = np.random.default_rng(5)
    for start, images in ((rough, smooth), (smooth, smooth)):
        frames = [images + rng.normal(0, 0.4, images.shape) for _ in range(4)]
        names = [finding.name for finding in looks(start, frames)[-1]]
        assert names == ([] if start is smooth else ["other_gel"])


def test_evidence_is_the_mean_of_its_frames(reconstruct, at_rest):
    drift = BackgroundDrift(reconstruct.background)
    result = reconstruct.from_image(at_rest[0])
    times_s = np.arange(0, MEAN_IMAGE_S + 0.5, 0.5)
    for index, time_s in enumerate(times_s):
        drift(at_rest[index % 10], replace(result, index=index, time_s=float(time_s)))
    evidence = drift.evidence
    expected = np.mean([at_rest[i % 10] for i in range(len(times_s))], axis=0)
    np.testing.assert_allclose(evidence.image, expected, rtol=1e-5)
    assert evidence.start is reconstruct.background
    assert not evidence.contact.any()
    assert evidence.different == 0


STEP_S = 5.0
BLOCKS = (20, 30)
UNTOUCHED = np.full((*BLOCKS, 3), 100, np.float32)
NOWHERE = np.zeros(BLOCKS, bool)


def run(memory, images, times_s):
    """The results of images at these times."""
    results = []
    for index, (image, time_s) in enumerate(zip(images, times_s)):
        result = replace(memory.result_from_image(image), index=index, time_s=float(time_s))
        results.append(memory(image, result))
    return results


def watched(memory, gel, times_s):
    """The results of the gel's images at these times."""
    rng = np.random.default_rng(5)
    return run(memory, (gel.image_at(time_s, rng) for time_s in times_s), times_s)


def kept(result, gel):
    """How deep the result is, in depths of the truth: the best factor over the press."""
    truth = gel.pressed_at(result.time_s).depth_mm
    return float((result.depth_mm * truth).sum() / (truth * truth).sum())


def rms_um(result):
    return 1e3 * float(np.sqrt(np.mean(np.square(result.depth_mm))))


@pytest.fixture(scope="module")
def two_presses(sensor):
    """0.2 mm over 180 s, twice on one place; LEDs drift all the while."""
    touches = tuple(Touch(start, 180.0, 5.0, 0.2, (1.5, -1.0), 4.0) for start in (30.0, 260.0))
    return SlowGel.drawn(sensor, np.random.default_rng(11), drift=0.03, touches=touches)


@pytest.mark.slow
def test_slow_presses_are_not_absorbed(reconstruct, two_presses):
    memory = Memory(reconstruct)
    results = watched(memory, two_presses, np.arange(0, 446, STEP_S))
    pressed = [r for r in results if two_presses.pressed_at(r.time_s).depth_mm.max() > 0.19]
    assert len(pressed) >= 3
    alone = watched(Memory(reconstruct), two_presses, [r.time_s for r in pressed][:1])[0]
    depths = [kept(result, two_presses) for result in pressed]
    assert min(depths) > 0.95 * kept(alone, two_presses)


@pytest.fixture(scope="module")
def drifting(sensor):
    """Light that turns across the image by 5 % and a hill of 30 um."""
    gel = SlowGel.drawn(sensor, np.random.default_rng(4), drift=0.05)
    ends = np.where(np.arange(len(sensor.leds)) % 4 < 2, 0.08, 0.02)
    return replace(gel, led_ends=ends, hill_mm=0.03, hill_width_mm=3.0)


@pytest.mark.slow
def test_drift_and_relaxation_are_followed(reconstruct, drifting):
    memory = Memory(reconstruct)
    results = watched(memory, drifting, np.arange(0, 601, STEP_S))
    assert max(rms_um(result) for result in results) < 5
    image = drifting.image_at(600, np.random.default_rng(6))
    alone, now = reconstruct.from_image(image), memory.reconstruct.from_image(image)
    assert rms_um(now) < 0.5 * rms_um(alone)


def test_smooth_light_is_followed_before_the_quarantine_ends(reconstruct, drifting):
    memory = Memory(reconstruct)
    watched(memory, drifting, np.arange(0, AFTER_S, STEP_S))
    truth = block_means(drifting.image_at(AFTER_S - STEP_S, None))
    start, now = (block_means(r.background) for r in (reconstruct, memory.reconstruct))
    assert np.abs(now - truth).mean() < 0.4 * np.abs(start - truth).mean()


def still(drift, image, result, times_s):
    """Show one image at these times; the last background that came of it."""
    found = None
    for index, time_s in enumerate(times_s):
        background = drift(image, replace(result, index=index, time_s=float(time_s)))
        found = found if background is None else background
    return found


@pytest.fixture
def spot(reconstruct, at_rest):
    """The gel with a faint spot, too small to be smooth light and too slight to be contact; the result of a frame."""
    spot = np.zeros(at_rest[0].shape[:2], np.float32)
    cv2.circle(spot, (60, 50), 6, 1.0, -1)
    rest = np.mean(at_rest, axis=0, dtype=np.float32)
    return rest, rest * (1 + 0.0015 * spot[..., None]), spot > 0, reconstruct.from_image(at_rest[0])


def test_what_is_slight_comes_late_and_slowly(spot):
    rest, spotted, inside, result = spot
    drift = BackgroundDrift(rest)
    early = still(drift, spotted, result, np.arange(0, AFTER_S, 2.0))
    assert np.abs(early[inside] / rest[inside] - 1).mean() < 2e-4
    late = still(drift, spotted, result, np.arange(AFTER_S, 400, 2.0))
    assert (late[inside] / rest[inside] - 1).mean() == pytest.approx(0.0015, rel=0.15)


def test_contact_after_it_keeps_it_out(spot):
    rest, spotted, inside, result = spot
    touched = replace(result, contact=inside)
    drift = BackgroundDrift(rest)
    for start in np.arange(0, 400, 50.0):  # touched every 50 s, for a second
        still(drift, spotted, result, np.arange(start, start + 48, 2.0))
        found = still(drift, spotted, touched, [start + 48, start + 49])
    assert np.abs(found[inside] / rest[inside] - 1).max() < 5e-4


@pytest.mark.slow
def test_a_gap_starts_the_quarantine_anew(spot):
    rest, spotted, inside, result = spot
    drift = BackgroundDrift(rest)
    for start in np.arange(0, 500, 60.0):
        found = still(drift, spotted, result, np.arange(start, start + 50, 2.0))  # then nobody looks for 10 s
    assert np.abs(found[inside] / rest[inside] - 1).max() < 5e-4


@pytest.mark.parametrize(("part", "gain"), [(0.3, 1.0), (0.0, 1.01)])
def test_a_gel_that_sinks_around_a_contact_is_no_light(spot, part, gain):
    """Smooth brightness is followed within seconds, unless something presses: then it may be the gel."""
    rest, contact = spot[0], np.zeros(spot[0].shape[:2], dtype=bool)
    contact[:, : round(part * contact.shape[1])] = True
    result = replace(spot[3], contact=contact)
    found = still(BackgroundDrift(rest), 1.01 * rest, result, np.arange(0, 20, 1.0))
    np.testing.assert_allclose(found[60:, 60:], gain * rest[60:, 60:], rtol=0.002)


def test_frames_that_measure_nothing_teach_nothing(spot):
    torn = replace(spot[3], health=(Finding("torn", "half of it", 0.5),))
    assert still(BackgroundDrift(spot[0]), spot[0] // 2, torn, np.arange(0, 200, 1.0)) is None


def test_light_that_would_be_beyond_white_is_white(spot):
    """A bright corner, all lights up by a quarter: what is smooth elsewhere promises more than a camera shows."""
    rest, _, _, result = spot
    rest[:12, :12] = 240
    found = still(BackgroundDrift(rest), np.minimum(1.25 * rest, 255), result, np.arange(0, 20, 1.0))
    assert found[:12, :12].min() == found.max() == 255
    np.testing.assert_allclose(found[60:, 60:], 1.25 * rest[60:, 60:], rtol=0.01)


def test_a_background_can_be_taken_in_any_light_but_not_of_a_pressed_gel(reconstruct, at_rest, pressed):
    x = np.linspace(0.85, 0.95, at_rest[0].shape[1])[:, None]
    dimmed, touched = ([(x * image).astype(np.uint8) for image in images] for images in (at_rest, pressed))
    memory = Memory(reconstruct)
    memory.take_background()
    refused = run(memory, cycle(touched), np.arange(30) / 10)[-1].health[-1]
    assert refused.name == "background_refused"
    assert "Something seems to touch the gel" in refused.message
    np.testing.assert_array_equal(memory.reconstruct.background.mean(), reconstruct.background.mean())
    memory.take_background()
    last = run(memory, cycle(dimmed), np.arange(30, 60) / 10)[-1]
    assert "background_refused" not in [finding.name for finding in last.health]
    assert memory.result_from_image(touched[0]).peak_mm == pytest.approx(0.4, abs=0.15)
    drift = BackgroundDrift(np.mean(at_rest, axis=0, dtype=np.float32))
    drift.asked = True
    still(drift, at_rest[0], memory.result_from_image(dimmed[0]), np.arange(0, 3, 0.5))
    assert drift.touched.not_since(0.0).all(), "whoever takes one says that nothing touches"
    assert abs(memory.result_from_image(dimmed[0]).depth).max() < 0.02


def test_a_refused_background_is_taken_when_it_is_asked_for_again(reconstruct, pressed):
    memory = Memory(reconstruct)
    for found in ("background_refused", "background_touched", "background_refused"):
        memory.take_background()
        first = 100 * len(found)
        last = run(memory, cycle(pressed), np.arange(first, first + 30) / 10)[-1]
        assert found in [finding.name for finding in last.health]
    assert memory.result_from_image(pressed[0]).peak_mm < 0.1, "it is the background now"


def noisy_background_drift(seed=0, levels=0.02):
    return np.random.default_rng(seed).normal(0, levels / 100, (*BLOCKS, 3)).astype(np.float32)


def marked(touched, change, second=1.0, contact=NOWHERE):
    """The blocks that are touched in this second."""
    touched.mark(float(second), 1.0, contact, change, UNTOUCHED)
    return ~touched.not_since(float(second))


def test_noise_and_light_that_changes_everywhere_touch_nothing():
    """Blocks are held against each other: a pattern all over raises what counts as noise."""
    touched = Touched(BLOCKS)
    for second in range(200):
        marked(touched, noisy_background_drift(second), second)
    assert touched.not_since(0.0).all()
    x = np.linspace(-0.01, 0.01, BLOCKS[1], dtype=np.float32)[None, :, None]
    assert not marked(Touched(BLOCKS), x + noisy_background_drift()).any()
    touched.everywhere(3.0)  # nobody looked
    assert not touched.not_since(3.0).any()
    touched.everywhere(-np.inf)
    assert touched.not_since(0.0).all()


def test_contact_counts_with_a_margin():
    touched, contact = Touched(BLOCKS), NOWHERE.copy()
    contact[10, 15] = True
    near = marked(touched, noisy_background_drift(), 50.0, contact)
    assert near[[10, 12, 10], [15, 15, 13]].all()
    assert not near[14, 15]
    assert near.sum() < 30
    assert touched.not_since(50.1).all()
    for blocks in ((1, 1), (3, 40)):
        rest, touched = np.full((*blocks, 3), 50, np.float32), Touched(blocks)
        touched.mark(0.0, 1.0, np.ones(blocks, bool), rest * 0, rest)
        assert not touched.not_since(0.0).any()


def test_a_block_that_stands_out_is_touched_and_what_is_slight_is_seen_in_time():
    """Half the noise limit of a second stands out of the mean of ten."""
    change = noisy_background_drift()
    change[5, 7, 1] = 0.004  # in one channel
    assert marked(Touched(BLOCKS), change)[5, 7]
    touched, seen = Touched(BLOCKS), []
    for second in range(30):
        change = noisy_background_drift(second, levels=0.12)
        change[5, 7] += 0.0045
        seen.append(bool(marked(touched, change, second)[5, 7]))
    assert all(seen[20:])
    touched, pressed = Touched(BLOCKS), noisy_background_drift()
    pressed[5, 7] = 0.4  # is forgotten soon
    for second in range(60):
        marked(touched, pressed if second < 20 else noisy_background_drift(second), second)
    assert touched.not_since(45.0).all()


LIGHT_BLOCKS = (17, 22)
TRUTH = np.array([[0.04, 0.02, -0.01, 3.0], [0.0, 0.03, 0.02, 5.0], [-0.02, 0.0, 0.01, -4.0]])


def error(seen, rest):
    """Largest relative error of the gel at rest in the light that is fitted, of all blocks."""
    found = lit(rest, light_at_rest(seen, rest, np.zeros((3, 4))))
    return np.abs(found / lit(rest, TRUTH) - 1).max()


def test_a_light_is_found_exactly_and_what_touches_does_not_bend_it():
    """A touched part that nobody named is an outlier; one that was named is 0 and does not count at all."""
    rest = levels(LIGHT_BLOCKS)
    seen = lit(rest, TRUTH).astype(np.float32)  # tilted, and in a lit room
    assert error(seen, rest) < 2e-4
    seen += np.random.default_rng(0).normal(0, 0.1, rest.shape).astype(np.float32)
    seen[5:9, 4:9] *= [1.3, 0.8, 1.1]
    assert error(seen, rest) < 2e-3
    seen[:, 8:] = 0
    assert error(seen, rest) < 0.2, "where nothing is free it is not thrown about"
