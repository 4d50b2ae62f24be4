"""Images, untouched images and sensor settings from files."""

import shutil

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.plots.canvas import save_picture
from gelform.sensors.files import (
    SensorSettings,
    averaged_background,
    read_background,
    read_image,
    read_sensor_toml,
)
from gelform.simulate import simulate_background
from gelform.view import View


@pytest.fixture
def picture():
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    return cv2.GaussianBlur(pixels, (0, 0), 2)


def write(path, pixels, suffix=".png"):
    path.write_bytes(cv2.imencode(suffix, pixels)[1].tobytes())
    return path


def test_red_is_the_first_channel(tmp_path):
    red = np.zeros((5, 7, 3), dtype=np.uint8)
    red[..., 2] = 250  # OpenCV's order is BGR
    image = read_image(write(tmp_path / "red.png", red))
    assert image.shape == (5, 7, 3)
    assert image.dtype == np.uint8
    assert image[0, 0].tolist() == [250, 0, 0]
    assert image.flags.c_contiguous


def test_formats(tmp_path, picture):
    for suffix in (".png", ".bmp", ".tiff", ".ppm", ".jpg", ".webp"):
        image = read_image(str(write(tmp_path / f"x{suffix}", picture, suffix)))
        exact = suffix not in (".jpg", ".webp")
        assert np.abs(image.astype(int) - picture[..., ::-1]).max() <= (0 if exact else 25)


def test_names_outside_ascii(tmp_path, picture):
    folder = tmp_path / "Mäßgerät 触覚"
    folder.mkdir()
    assert np.array_equal(read_image(write(folder / "прижим é.png", picture)), picture[..., ::-1])


def test_truncated_files_are_refused_in_silence(tmp_path, capfd, picture):
    for suffix in (".png", ".jpg", ".bmp", ".tiff", ".ppm"):
        for kept in (0.05, 0.5, 0.9, 0.99):
            path = write(tmp_path / f"x{suffix}", picture, suffix)
            content = path.read_bytes()
            path.write_bytes(content[: int(kept * len(content))])
            with pytest.raises(DataError, match=r"truncated or damaged|no image that can be read"):
                read_image(path)
            if suffix in (".png", ".jpg") or hasattr(
                cv2.utils, "logging"
            ):  # OpenCV 4 cannot be told to be silent
                assert capfd.readouterr() == ("", "")


def test_a_damaged_png_is_refused(tmp_path, picture):
    path = write(tmp_path / "x.png", picture)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))
    with pytest.raises(DataError, match="truncated or damaged"):
        read_image(path)


def test_other_images_are_refused_with_what_they_are(tmp_path, picture):
    with pytest.raises(DataError, match=r"got a grey one.*three channels"):
        read_image(write(tmp_path / "grey.png", picture[..., 0]))
    with pytest.raises(DataError, match=r"got uint16.*8 bits"):
        read_image(write(tmp_path / "deep.png", picture.astype(np.uint16) * 200))
    with pytest.raises(DataError, match=r"got 4 \(an alpha channel\?\).*without transparency"):
        read_image(write(tmp_path / "alpha.png", np.dstack([picture, picture[..., :1]])))


def test_what_is_no_image_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "empty.png").touch()
    for name, text in (
        ("text.png", "no image"),
        ("empty.png", "is empty"),
        ("missing.png", "No file"),
        (".", "got the folder"),
    ):
        with pytest.raises(DataError, match=text):
            read_image(tmp_path / name)


def test_sensor_toml(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(
        'name = "Gel é"\nmm_per_px = 0.05\nserial = "A1"\n[view]\nframe_shape = [480, 640]\nflip = "x"\n',
        "utf-8",
    )
    assert read_sensor_toml(path) == SensorSettings(
        "Gel é", 0.05, serial="A1", view=View((480, 640), flip="x")
    )
    path.write_text('name = "G"\nmm_per_px = 0.1\n[camera]\nexposure = 50\nfourcc = "MJPG"\n')
    assert read_sensor_toml(path).camera == {"exposure": 50, "fourcc": "MJPG"}
    path.write_text('name = "G"\nmm_per_px = 1\nmm_per_px_sigma = 0.01\n')
    assert read_sensor_toml(path) == SensorSettings("G", 1.0, mm_per_px_sigma=0.01)


def test_wrong_sensor_toml(tmp_path):
    for text, said in (
        ('name = "G"', "mm_per_px missing"),
        ("mm_per_px = 0.05", "name missing"),
        ('name = "G"\nmm_per_px = 0', r"mm_per_px > 0, got 0"),
        ('name = "G"\nmm_per_px = "x"', "mm_per_px as a number"),
        ('name = "G"\nmm_per_px = "0.1"', "mm_per_px as a number, got '0.1'"),
        ('name = "G"\nmm_per_px = true', "mm_per_px as a number, got True"),
        ('name = "G"\nmm_per_px = 1e300', "got 1e[+]300"),
        ('name = "G"\nmm_per_px = 15.8', r"If these are pixels per mm, give 1/15.8 = 0.06329"),
        ('name = "G"\nmm_per_px = 0.05\nmm_per_px_sigma = "1"', "mm_per_px_sigma as a number"),
        ('name = "G"\nmm_per_px = 0.05\ngel_thickness_mm = 0', "gel_thickness_mm between 0.05 and 50, got 0"),
        ('name = "G"\nmm_per_px = 0.05\nscale = 3', "got scale"),
        ('name = "G"\nmm_per_px = 0.05\nserial = 3', "serial as text"),
        ('name = "G"\nmm_per_px = 0.05\nview = 3', r"table \[view\]"),
        ('name = "G"\nmm_per_px = 0.05\n[view]\nflop = "x"', "got flop"),
        ('name = "G"\nmm_per_px = 0.05\ncamera = 3', r"table \[camera\]"),
        ('name = "G"\nmm_per_px = 0.05\n[camera]\ngain = true', r"gain of \[camera\] as a number"),
        ('name = "G"\nmm_per_px = 0.05\n[camera]\ngain = nan', r"gain of \[camera\] as a number"),
        ("name = ", "no TOML"),
    ):
        path = tmp_path / "sensor.toml"
        path.write_text(text)
        with pytest.raises(DataError, match=said) as caught:
            read_sensor_toml(path)
        assert "sensor.toml" in str(caught.value)


def test_bytes_that_are_no_text(tmp_path):
    (tmp_path / "sensor.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="no text in UTF-8"):
        read_sensor_toml(tmp_path / "sensor.toml")


def test_a_recording_in_place_of_an_image_is_told_where_to_go(tmp_path):
    for name in ("s.mcap", "s.MP4"):
        (tmp_path / name).write_bytes(b"not an image")
        with pytest.raises(DataError, match="gelform batch"):
            read_image(tmp_path / name)


@pytest.fixture
def rests(sensor, tmp_path):
    """Five untouched frames in a folder."""
    rng = np.random.default_rng(8)
    images = [simulate_background(sensor, rng) for _ in range(5)]
    (tmp_path / "background").mkdir()
    for k, image in enumerate(images):
        save_picture(tmp_path / "background" / f"{k}.png", image)
    return tmp_path / "background"


def test_one_image_is_itself(rests):
    image = read_background(rests / "0.png")
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, gelform.read_image(rests / "0.png"))


def test_a_folder_is_averaged(rests):
    images = [gelform.read_image(path) for path in sorted(rests.iterdir())]
    found = averaged_background(rests)
    np.testing.assert_array_equal(read_background(rests), found.background)
    np.testing.assert_array_equal(read_background(sorted(rests.iterdir())), found.background)
    one = np.std(images[0].astype(float) - np.mean(images[1:], axis=0))
    assert found.noise.mean() == pytest.approx(one / np.sqrt(1 + 1 / 4), rel=0.1)


def test_a_press_folder_may_hold_a_folder_of_backgrounds(folder, rests, tmp_path):
    again = tmp_path / "presses"
    shutil.copytree(folder, again)
    (again / "background.png").unlink()
    shutil.copytree(rests, again / "background")
    presses = gelform.read_presses(again)
    np.testing.assert_array_equal(presses.background, read_background(rests))
    assert len(presses.presses) == len(gelform.read_presses(folder).presses)
    named = gelform.read_presses(folder, background=rests)
    np.testing.assert_array_equal(named.background, presses.background)


def test_what_is_no_background_is_refused(rests, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="empty, got none"):
        read_background(tmp_path / "empty")
    save_picture(rests / "9.png", np.zeros((20, 30, 3), dtype=np.uint8))
    with pytest.raises(DataError, match=r"untouched gel in .*20x30"):
        read_background(rests)
