"""Import of other packages' calibrations: known values, values that stay unknown, refusals."""

import numpy as np
import pytest

import gelform
from gelform.exchange.importers.calibrations import UNTOUCHED_CHANGE
from gelform.image.view import image_from_frame
from gelform.sensors.profiles import PROFILES
from made.networks import web_file

SHAPE = (48, 64)
BACKGROUND = np.random.default_rng(0).integers(60, 160, (*SHAPE, 3)).astype(np.uint8)
WEB = {"package": "gsrobotics-web", "background": BACKGROUND, "position": "true"}


@pytest.fixture
def network(tmp_path):
    return web_file(tmp_path / "weights.bin")


def pressed():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    bump = 40 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 30)
    return np.clip(BACKGROUND + bump[..., None] * np.array([1, -0.5, 0.3]), 1, 254).astype(np.uint8)


def test_unknown_stays_unknown_and_with_a_scale_depth_is_in_mm(network, tmp_path):
    calibration = gelform.import_calibration(network, **WEB)
    assert (calibration.mm_per_px, calibration.forward, calibration.slope_sigma) == (None, None, None)
    assert calibration.settings == {"imported_from": "gsrobotics-web", "position": "true"}
    assert calibration.sensor_name == "weights"
    calibration.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    a, b = (gelform.Reconstructor(one)(pressed()) for one in (calibration, again))
    np.testing.assert_array_equal(a.gradients, b.gradients)
    np.testing.assert_array_equal(a.depth_px, b.depth_px)
    assert a.gradients_sigma is None
    calibration = gelform.import_calibration(network, **WEB, mm_per_px=0.05)
    result = gelform.Reconstructor(calibration)(pressed())
    np.testing.assert_allclose(result.depth_px * 0.05, result.depth_mm, rtol=1e-5)


def test_the_image_is_recovered_from_the_change(network):
    """Through the color change comes what the network says of the image itself, less what it says at rest."""
    calibration = gelform.import_calibration(network, **WEB)
    model, image = calibration.color_model, pressed()
    black, full = model.prepare(np.zeros((*SHAPE, 3)), SHAPE), np.float32(255)
    said = [black.gradients_from_color(one.astype(np.float32) / full)[0] for one in (image, BACKGROUND)]
    change = gelform.color_change_from_image(image, BACKGROUND, calibration.change)
    found, _ = model.prepare(BACKGROUND, SHAPE).gradients_from_color(change)
    np.testing.assert_allclose(found, said[0] - said[1], atol=5e-6)


def test_options_belong_to_packages(network, tmp_path):
    for package, options, why in (
        ("digit-depth", {}, "Expected a package among gs_sdk"),
        ("gs_sdk", {"position": "true"}, "Expected position"),
        ("gsrobotics", {}, "Expected position"),
        ("gsrobotics", {"position": "maybe"}, "Expected position"),
        ("gs_sdk", {"flip_depth": True}, "flip_depth for lut only"),
        ("gs_sdk", {"mm_per_px": -1}, "mm_per_px > 0"),
    ):
        with pytest.raises(ValueError, match=why):
            gelform.import_calibration(network, package, background=BACKGROUND, **options)


def test_untouched_pixels_of_a_real_sensor_are_called_untouched(data):
    """Far from the object, 8 gray levels hold 97 % and more of the pixels; in contact they do not."""
    folder = data / "mini-objects"
    background = gelform.read_image(folder / "background.png").astype(np.float32)
    change = np.abs(gelform.read_image(folder / "key.png").astype(np.float32) - background) / 255
    size = np.linalg.norm(change, axis=-1)
    assert np.mean(size[:, :100] < UNTOUCHED_CHANGE) > 0.97
    assert np.mean(size[110:150, 190:230] < UNTOUCHED_CHANGE) < 0.2


@pytest.mark.parametrize("package", ["gs_sdk", "gsrobotics"])
def test_a_real_press_stands_up(data, package):
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    peers = data / "peer-calibrations"
    file = peers / ("gs_sdk-mini-c-nnmodel.pth" if package == "gs_sdk" else "gsrobotics-nnmini.pt")
    calibration = gelform.import_calibration(
        file,
        package,
        background=gelform.read_image(data / "mini-objects" / "background.png"),
        mm_per_px=0.0634,
        position=None if package == "gs_sdk" else "zeros",
    )
    result = gelform.Reconstructor(calibration)(gelform.read_image(data / "mini-objects" / "key.png"))
    assert 0.8 < result.peak_mm < 2.5
    assert result.contact[130:140, 205:225].mean() > 0.6  # its relief is hollow in places
    assert not result.contact[:, :100].any()


def smooth(shape):
    """A background without texture, equal at equal places of the gel whatever its size."""
    y, x = ((np.arange(count) + 0.5) / count for count in shape)
    ramp = 80 + 60 * x[None] + 40 * y[:, None]
    return np.stack([ramp, 230 - ramp, ramp / 2 + 60], axis=-1)


def test_a_frame_of_the_camera_is_cropped_as_the_package_crops(network):
    """One gel, given as the camera's frame and as the package's image: one calibration, and one answer to both."""
    how = {"package": "gsrobotics-web", "position": "true", "mm_per_px": 0.0634}
    frame = smooth((2464, 3280))
    image = image_from_frame(frame, PROFILES["gelsight-mini"].view((2464, 3280)))
    by_frame = gelform.import_calibration(network, background=frame, **how)
    by_image = gelform.import_calibration(network, background=image, **how)
    assert by_frame.image_shape == by_image.image_shape == (240, 320)
    assert by_frame.view == by_image.view
    np.testing.assert_allclose(by_frame.background, by_image.background, atol=1e-3)
    frame[1200:1300, 1600:1750] += [20, -10, 5]
    seen = image_from_frame(frame, by_frame.view)
    a, b = gelform.Reconstructor(by_image)(frame), gelform.Reconstructor(by_frame)(seen)
    assert a.peak_mm == pytest.approx(b.peak_mm, rel=1e-3)
    halved = gelform.import_calibration(network, background=smooth((480, 640)), **how)
    assert (halved.view.frame_shape, halved.image_shape) == ((480, 640), (240, 320))


def test_a_frame_of_another_sensor_stays_as_it_is(network):
    how = {"package": "gsrobotics-web", "position": "true"}
    for shape, pitch in (((480, 640), 0.03), ((480, 640), None), ((240, 320), None), ((300, 427), 0.0634)):
        made = gelform.import_calibration(network, background=smooth(shape), mm_per_px=pitch, **how)
        assert made.view.is_identity
        assert made.image_shape == shape


def test_a_gel_that_no_sensor_has_and_the_scale_of_a_frame_are_refused(network):
    how = {"package": "gsrobotics-web", "position": "true"}
    with pytest.raises(ValueError, match=r"between 3 and 150 mm wide, got 3282 px of 0.0634 mm: 208 mm"):
        gelform.import_calibration(network, background=smooth((2000, 3282)), mm_per_px=0.0634, **how)
    with pytest.raises(ValueError, match=r"got 320 px of 0.00634 mm: 2.03 mm"):
        gelform.import_calibration(network, background=smooth((240, 320)), mm_per_px=0.00634, **how)
    with pytest.raises(ValueError, match=r"images of 240x320 px, .*about 0.0634, got 0.009"):
        gelform.import_calibration(network, background=smooth((2464, 3280)), mm_per_px=0.009, **how)
