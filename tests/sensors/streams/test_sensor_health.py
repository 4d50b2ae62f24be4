"""Faults of a sensor: a repeated image, the light, settings of the camera, marks on the gel, another or a moved gel.

The gels and their faults are simulated.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import gelform
from gelform.calibration.presses.taken import TakenPresses
from gelform.errors import SourceLostError
from gelform.sensors import SensorSettings
from gelform.sensors.streams.background_drift import DriftEvidence
from gelform.sensors.streams.marks import Marks
from gelform.sensors.streams.same_gel import SameGel
from gelform.sensors.streams.sensor_health import CameraCheck, Frozen, light_findings, light_from_outside
from gelform.simulate import simulate_background
from gelform.simulate.sensor.coating import Coating
from live_waiting import until
from made.sources import ImageSource
from stream.sensor_faults import CHANGES, ONSET_S, Gel, dust, moved, scratch, tear

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
    assert named([1.0, 1.06, 1.0]) == {"color_shift": pytest.approx(0.06)}


def evidence(now, contact=None):
    nowhere, start = np.zeros(SHAPE, bool), start_levels()
    touched = nowhere if contact is None else contact
    return DriftEvidence(now.astype(np.float32), start, start, nowhere, touched)


def start_levels():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / SHAPE[1]
    return np.stack([40 + 90 * x, 120 - 60 * y, 60 + 60 * x * y], axis=-1).astype(np.float32)


def noise(seed=0):
    return np.random.default_rng(seed).normal(0, 0.5, (*SHAPE, 3))


def test_light_from_outside_is_added_in_every_channel():
    (found,) = light_from_outside(evidence(0.97 * start_levels() + 10 + noise()))
    assert found.name == "room_light"
    assert found.figure == pytest.approx(10, abs=1.5)
    assert (
        light_from_outside(evidence(start_levels() + 2 + noise())) == ()
    )  # it is removed, and not worth a word


def test_the_sensors_own_light_one_channel_and_what_touches_are_none():
    start, contact = start_levels(), np.zeros(SHAPE, bool)
    for gain in (0.75, 1.0, 1.3):
        assert light_from_outside(evidence(gain * start + noise())) == ()
    assert light_from_outside(evidence(start + np.array([15, 0, 0]) + noise())) == ()
    now = start + noise()
    now[:, 40:] += 30
    contact[:, 40:] = True
    assert light_from_outside(evidence(now, contact)) == ()
    assert light_from_outside(evidence(now, np.ones(SHAPE, bool))) == ()


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
    check = CameraCheck(replace(calibration, serial="D1"))
    (finding,) = check(camera("D2"))
    assert finding.name == "other_camera"
    assert "serial is D2, but the calibration is of D1" in finding.message
    unknown = CameraCheck(replace(calibration, serial=None))
    assert check(camera("D1")) == check(camera()) == unknown(camera("D2")) == ()
    check = CameraCheck(taken_with(calibration, exposure=100.0))
    assert check(camera(exposure=100.0)) == check(camera()) == ()
    assert CameraCheck(calibration)(camera(exposure=100.0)) == ()


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


def marks_in(images, contact=None):
    marks, rng = Marks(), np.random.default_rng(0)
    nowhere = np.zeros(MARKED_SHAPE, bool)
    found = ()
    for image in images:
        noisy = (image + rng.normal(0, 0.2, image.shape)).astype(np.float32)
        start = REST.astype(np.float32)
        found = marks(DriftEvidence(noisy, start, start, nowhere, nowhere if contact is None else contact))
    return [finding.name for finding in found]


@pytest.mark.parametrize("fault", [scratch, dust, tear])
def test_each_is_named_when_it_stays(fault):
    marked = fault(REST, np.random.default_rng(8))
    assert marks_in([REST] * 5) == marks_in([REST, marked, marked]) == []
    assert marks_in([REST, marked, marked, marked]) == [fault.__name__]


def test_what_comes_and_goes_or_rests_there_is_no_mark():
    """A scratch within a wide contact is the relief of what touches."""
    spot, groove = (fault(REST, np.random.default_rng(8)) for fault in (dust, scratch))
    assert marks_in([spot, spot, REST, spot, spot]) == []
    assert marks_in([groove] * 4, contact=np.ones(MARKED_SHAPE, bool)) == []


def test_the_ragged_edge_of_what_rests_there_is_no_mark():
    """A body's contact ends in thin parts, farther from where it is wide than a mark's surroundings."""
    groove = scratch(REST, np.random.default_rng(8))
    y, x = np.nonzero(groove.mean(axis=-1) != 100)
    body = np.zeros(MARKED_SHAPE, bool)
    body[:, : x.min() - 40] = True
    body[y.min() : y.max() + 1 : 3, x.min() - 40 : x.min() + 1] = True  # narrow tongues that reach it
    assert marks_in([groove] * 4, contact=np.zeros(MARKED_SHAPE, bool)) == ["scratch"]
    assert marks_in([groove] * 4, contact=body) == []


def test_a_short_groove_is_a_scratch_and_a_short_dark_spot_is_none():
    """Both 20 px long and about 8 wide: the groove is bright on one side and dark on the other."""
    y, x = np.mgrid[: MARKED_SHAPE[0], : MARKED_SHAPE[1]]
    along, across = np.clip((10 - np.abs(x - 90)) / 2, 0, 1), (y - 70) / 2.2
    groove = 0.2 * along * across * np.exp(0.5 - across**2 / 2)
    spot = -0.2 * along * np.exp(-(across**4) / 10)
    for name, shape in (("scratch", groove), ("dust", spot)):
        assert marks_in([REST * (1 + shape[..., None])] * 4) == [name]


@pytest.fixture(scope="module")
def gel(sensor):
    return Gel.drawn(sensor, np.random.default_rng(1))


def looks(start, images, *, touched=0.0, different=0.0):
    same_gel, shape = SameGel(start.astype(np.float32)), start.shape[:2]
    somewhere = np.zeros(shape, bool)
    somewhere[: int(touched * shape[0])] = True
    nowhere, start = np.zeros(shape, bool), start.astype(np.float32)
    return [
        same_gel(DriftEvidence(image.astype(np.float32), start, start, somewhere, nowhere, different))
        for image in images
    ]


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
    coatings = [Coating(roughness=roughness, seed=seed) for roughness, seed in ((0.009, 1), (0.003, 2))]
    rough, smooth = (
        simulate_background(replace(sensor, coating=one), None, quantise=False) for one in coatings
    )
    rng = np.random.default_rng(5)
    for start, images in ((rough, smooth), (smooth, smooth)):
        frames = [images + rng.normal(0, 0.4, images.shape) for _ in range(4)]
        names = [finding.name for finding in looks(start, frames)[-1]]
        assert names == ([] if start is smooth else ["other_gel"])
