"""Frames go through the view, images do not: two doors, and nothing is guessed from a shape."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.view import View

FLIP_TOML = 'name = "turned"\nmm_per_px = {:.6f}\n[view]\nflip = "x"\n'


@pytest.fixture(scope="module")
def mounted(folder, tmp_path_factory):
    """Eight presses as mounted, and the same seen in a mirror by a camera whose view turns them back."""
    import shutil

    few = gelform.read_presses(folder)
    few = few.subset(range(8))
    mirror = tmp_path_factory.mktemp("mirror") / "folder"
    shutil.copytree(folder, mirror)
    for path in mirror.rglob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path))[:, ::-1])
    (mirror / "sensor.toml").write_text(FLIP_TOML.format(few.mm_per_px))
    return few, gelform.read_presses(mirror).subset(range(8))


@pytest.fixture(scope="module")
def calibrations(mounted):
    return [gelform.calibrate(one, color_model="lambertian") for one in mounted]


def test_turned_frames_calibrate_as_mounted_ones_do(mounted, calibrations):
    """One size for frames and images: whoever guesses from the shape turns the presses once more."""
    straight, turned = calibrations
    np.testing.assert_array_equal(mounted[0].presses[0].image, mounted[1].presses[0].image)
    assert turned.view == View(flip="x")
    assert turned.held_out == straight.held_out
    np.testing.assert_array_equal(turned.color_model.lights, straight.color_model.lights)
    one, other = (gelform.evaluate(c, p).summary for c, p in zip(calibrations, mounted))
    assert one == other


def test_a_frame_is_always_turned_and_an_image_never(mounted, calibrations):
    image = mounted[0].presses[0].image
    reconstruct = gelform.Reconstructor(calibrations[1])
    expected = gelform.Reconstructor(calibrations[0])(image).depth_mm
    np.testing.assert_array_equal(reconstruct(image[:, ::-1]).depth_mm, expected)
    np.testing.assert_array_equal(reconstruct.from_image(image).depth_mm, expected)
    with pytest.raises(gelform.CalibrationError, match="background is not of this image"):
        reconstruct(image)


def test_each_door_names_the_other(calibration, simulated):
    """A view that halves the frame: sizes tell what was given, and the message says where it belongs."""
    height, width = calibration.image_shape
    halved = View((2 * height, 2 * width), image_shape=(height, width))
    reconstruct = gelform.Reconstructor(replace(calibration, view=halved))
    image = simulated.presses[0].image
    frame = cv2.resize(image, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
    np.testing.assert_array_equal(reconstruct(frame).depth_mm, reconstruct.from_image(image).depth_mm)
    with pytest.raises(
        ValueError, match=r"frame of 264x352 px .*, got 132x176.*an image already.*from_image"
    ):
        reconstruct(image)
    with pytest.raises(ValueError, match=r"image of 132x176 px .*, got 264x352.*frame.*image_from_frame"):
        reconstruct.from_image(frame)
    with pytest.raises(ValueError, match=r"background of 132x176 px .*, got 264x352.*image_from_frame"):
        gelform.Reconstructor(replace(calibration, view=halved), background=frame)


def test_a_path_is_a_calibration_and_a_wrong_solver_is_refused_at_once(calibration, simulated, tmp_path):
    calibration.save(tmp_path / "cal.npz")
    image = simulated.presses[0].image
    for path in (tmp_path / "cal.npz", str(tmp_path / "cal.npz")):
        again = gelform.Reconstructor(path, solver="dct")(image)
    np.testing.assert_array_equal(
        again.depth_mm, gelform.Reconstructor(calibration, solver="dct")(image).depth_mm
    )
    with pytest.raises(gelform.CalibrationError, match=r"No file .*nothing\.npz"):
        gelform.Reconstructor(tmp_path / "nothing.npz")
    with pytest.raises(TypeError, match=r"Expected a Calibration or the path of one, got dict"):
        gelform.Reconstructor({})
    with pytest.raises(ValueError, match=r"Expected a solver among auto, .*got 'poisson'"):
        gelform.Reconstructor(calibration, solver="poisson")
