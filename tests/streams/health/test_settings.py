"""What decides the colours and was another at the calibration is a finding of every result."""

from dataclasses import replace

import pytest

import gelform
from gelform.calibration.presses.taken import TakenPresses
from gelform.errors import SourceLostError
from gelform.sensors import SensorSettings
from gelform.streams.health.settings import CameraCheck
from made.sources import ImageSource


def camera(calibration, **settings):
    return replace(calibration, settings={**calibration.settings, "camera": settings})


def source_of(images, settings, **how):
    source = ImageSource(images, **how)
    source.settings = settings
    return source


def mismatches(result):
    return [one for one in result.health if one.name == "settings_mismatch"]


def test_another_exposure_is_a_finding_of_the_stream(calibration, at_rest):
    source = source_of(at_rest, {"exposure": 200.0, "gain": 1.0}, live=False, count=2)
    results = list(gelform.stream(source, camera(calibration, exposure=100.0, gain=1.0)))
    for result in results:
        (finding,) = mismatches(result)
        assert finding.figure == 1
        assert "exposure 200.0 instead of 100.0" in finding.message


def test_the_same_or_unknown_settings_are_none(calibration):
    check = CameraCheck(camera(calibration, exposure=100.0))
    assert check(None, {"exposure": 100.0}) == check(None, {}) == ()
    assert CameraCheck(calibration)(None, {"exposure": 100.0}) == ()


def test_another_unit_is_named_where_both_serials_are_known(calibration):
    check = CameraCheck(replace(calibration, serial="D1"))
    (finding,) = check("D2", {})
    assert finding.name == "other_camera"
    assert "serial is D2, the calibration is of D1" in finding.message
    assert (
        check("D1", {}) == check(None, {}) == CameraCheck(replace(calibration, serial=None))("D2", {}) == ()
    )


def test_a_camera_that_forgot_its_settings_when_it_was_unplugged_is_found(calibration, at_rest):
    lost = SourceLostError("unplugged")
    plugged = [
        source_of(at_rest, {"exposure": 100.0}, count=3, fails=lost),
        source_of(at_rest, {"exposure": 250.0}),
    ]
    with gelform.stream(lambda: plugged.pop(0), camera(calibration, exposure=100.0)) as stream:
        first = stream.newest(timeout_s=60)
        assert mismatches(first.result) == []
        index = first.index
        while index < 4:
            seen = stream.newest(index, timeout_s=60)
            index = seen.index
        assert "exposure 250.0 instead of 100.0" in mismatches(seen.result)[0].message


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
