"""Images, background images, sensor settings and TOML from files; videos whose name OpenCV cannot take."""

import os
import shutil
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor
from io import BytesIO
from weakref import WeakSet

import cv2
import numpy as np
import pytest

import gelform
from gelform.cli import main
from gelform.errors import DataError, SensorError
from gelform.exchange.plots import save_picture
from gelform.image.view import View
from gelform.sensors.files import (
    SensorSettings,
    background_in,
    images_of_stack,
    is_stack,
    read_background,
    read_image,
    read_sensor_toml,
    read_toml,
)
from gelform.sensors.films import Video, open_film
from gelform.sensors.pictures import begin_tiff_at, tiff_pages
from gelform.sensors.source import open_source
from gelform.simulate import simulate_background
from made.sources import video_file

FAULTS = {
    "nested": (b"a = " + b"[" * 20_000 + b"]" * 20_000, "holds tables inside tables beyond reason"),
    "dotted": (b"a" + b".a" * 2_000 + b" = 1", "holds tables inside tables beyond reason|is no TOML"),
    "latin": ("name = 'Pr\u00fcfling'".encode("latin-1"), "is no text in UTF-8: byte 10"),
    "torn": (b"name = my gel", "is no TOML file.*Text stands in quotes"),
}


@pytest.mark.parametrize("fault", ["nested", "latin", "torn"])
def test_a_fault_is_a_sentence(tmp_path, fault):
    path = tmp_path / "sensor.toml"
    path.write_bytes(FAULTS[fault][0])
    for error in (DataError, SensorError):
        with pytest.raises(error, match=FAULTS[fault][1]):
            read_toml(path, "settings", error)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    "command",
    [
        "design {}",
        "simulate --sensor {} -o out",
        "info {}/..",
        "live simulated:{}",
        "calibrate {}/.. -o a.npz",
    ],
)
def test_every_command_that_reads_one_says_it(tmp_path, capsys, monkeypatch, fault, command):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "sensor.toml"
    path.write_bytes(FAULTS[fault][0])
    with pytest.raises(SystemExit) as stopped:
        main(command.replace("{}/..", str(tmp_path)).replace("{}", str(path)).split(" "))
    assert stopped.value.code in (0, 1, 2), capsys.readouterr().err
    assert "bug" not in capsys.readouterr().err


@pytest.fixture
def odd_name(tmp_path):
    """A video that can be decoded, under a name of bytes that are no UTF-8."""
    path = video_file(tmp_path / "presses.avi", [np.full((64, 80, 3), 100, np.uint8)] * 3)
    assert len(list(Video(path))) == 3
    try:
        return path.rename(tmp_path / os.fsdecode(b"presses \xff.avi"))
    except OSError:
        pytest.skip("this file system has names in UTF-8 alone")


def test_a_name_that_is_no_utf_8_is_refused_everywhere(odd_name, calibration, tmp_path, capsys):
    for reader in (Video, open_source, open_film):
        with pytest.raises(DataError, match=r"udcff.avi' is no UTF-8. Rename it"):
            reader(odd_name)
    calibration.save(tmp_path / "cal.npz")
    after = ["-c", str(tmp_path / "cal.npz"), "-o"]
    in_batch = ["batch", *after, str(tmp_path / "out"), "--table", "csv"]
    for command, *options in (["info"], ["reconstruct", *after, str(tmp_path / "film")], in_batch):
        with pytest.raises(SystemExit, match=r"^1$"):
            main([command, str(odd_name), *options])
    assert "no UTF-8. Rename it" in capsys.readouterr().err
    assert "no UTF-8. Rename it" in (tmp_path / "out" / "frames.csv").read_text()


@pytest.fixture
def picture():
    pixels = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    return cv2.GaussianBlur(pixels, (0, 0), 2)


def write(path, pixels, suffix=".png"):
    path.write_bytes(cv2.imencode(suffix, pixels)[1].tobytes())
    return path


def test_red_is_the_first_channel_of_every_format(tmp_path, picture):
    red = np.zeros((5, 7, 3), dtype=np.uint8)
    red[..., 2] = 250  # OpenCV's order is BGR
    image = read_image(write(tmp_path / "red.png", red))
    assert (image.shape, image.dtype, image[0, 0].tolist()) == ((5, 7, 3), np.uint8, [250, 0, 0])
    assert image.flags.c_contiguous
    folder = tmp_path / "Mäßgerät 触覚"
    folder.mkdir()
    for suffix in (".png", ".bmp", ".tiff", ".ppm", ".jpg", ".webp"):
        image = read_image(str(write(folder / f"прижим é{suffix}", picture, suffix)))
        exact = suffix not in (".jpg", ".webp")
        assert np.abs(image.astype(int) - picture[..., ::-1]).max() <= (0 if exact else 25)


@pytest.fixture
def stack(picture):
    """Four images that differ, RGB."""
    return np.stack([np.roll(picture, 7 * k, axis=1)[..., ::-1] for k in range(4)])


def stack_file(path, images):
    """The images as a TIFF of pages, or an array of numpy."""
    if path.suffix == ".npy":
        np.save(path, images)
    else:
        assert cv2.imwritemulti(str(path), [image[..., ::-1] for image in images])
    return path


@pytest.mark.parametrize("suffix", [".npy", ".tiff", ".tif"])
def test_all_images_of_a_file_are_frames(tmp_path, stack, suffix):
    path = stack_file(tmp_path / f"stack{suffix}", stack)
    with gelform.open_source(path) as source:
        frames = list(source)
    np.testing.assert_array_equal([frame.image for frame in frames], stack)
    assert [frame.time_s for frame in frames] == [k / 25 for k in range(4)]
    np.testing.assert_array_equal(open_film(path)[2].image, stack[2])
    numbers = [k % 4 for k in range(200)]
    with ThreadPoolExecutor(4) as threads:  # a recording may be shared while it plays
        together = list(threads.map(open_film(path).__getitem__, numbers))
    np.testing.assert_array_equal([frame.image for frame in together], stack[numbers])
    with pytest.raises(
        DataError, match=r"holds several images\. Give it to gelform reconstruct, batch or live"
    ):
        read_image(path)
    one = stack_file(tmp_path / f"one{suffix}", stack[:1] if suffix != ".npy" else stack[0])
    np.testing.assert_array_equal(read_image(one), stack[0])
    assert not is_stack(one)


def test_pages_are_counted_in_either_order_of_bytes_and_up_to_damage(tmp_path, stack):
    content = stack_file(tmp_path / "stack.tiff", stack).read_bytes()
    assert len(tiff_pages(BytesIO(content))) == 4
    last = max(tiff_pages(BytesIO(content)))
    assert len(tiff_pages(BytesIO(content[: last + 1]))) == 3
    empty = struct.pack(">HI", 0, 8 + 6)
    assert tiff_pages(BytesIO(b"MM\0*" + struct.pack(">I", 8) + empty + struct.pack(">HI", 0, 0))) == (8, 14)
    big = b"II+\0" + struct.pack("<HHQ", 8, 0, 16) + struct.pack("<QQ", 0, 32) + struct.pack("<QQ", 0, 0)
    assert tiff_pages(BytesIO(big)) == (16, 32)
    assert tiff_pages(BytesIO(big), 1) == (16,)
    begun = bytearray(big)
    begin_tiff_at(begun, 32)
    assert begun == big[:8] + struct.pack("<Q", 32) + big[16:]
    loop = b"II*\0" + struct.pack("<I", 8) + struct.pack("<HI", 0, 8)
    assert tiff_pages(BytesIO(loop)) == (8,)
    assert tiff_pages(BytesIO(b"\x89PNG" + bytes(30))) == ()


def test_the_gel_at_rest_may_be_an_array_or_several_pages(tmp_path, sensor):
    rest = simulate_background(sensor, np.random.default_rng(0)).astype(np.uint8)
    noise = [np.random.default_rng(k).normal(0, 1, rest.shape) for k in range(4)]
    noisy = np.clip(rest + np.stack(noise), 0, 255)
    for suffix in (".npy", ".tiff"):
        path = stack_file(tmp_path / f"background{suffix}", noisy.astype(np.uint8))
        assert np.abs(read_background(path) - rest).mean() < 0.8
        assert background_in(tmp_path) == path
        path.unlink()
    average = stack_file(tmp_path / "background.npy", noisy.mean(axis=0))
    np.testing.assert_allclose(read_background(average), noisy.mean(axis=0), atol=1e-4)
    stack_file(average, noisy[0] / 300)
    with pytest.raises(DataError, match=r"gray levels from 0 to 255 in .*background.npy, got "):
        read_background(average)


def test_truncated_files_are_refused_in_silence(tmp_path, capfd, picture):
    for suffix in (".png", ".jpg", ".bmp", ".tiff", ".ppm"):
        for kept in (0.05, 0.5, 0.9, 0.99):
            path = write(tmp_path / f"x{suffix}", picture, suffix)
            content = path.read_bytes()
            path.write_bytes(content[: int(kept * len(content))])
            with pytest.raises(DataError, match=r"truncated or damaged|no image that can be read"):
                read_image(path)
            silent = hasattr(cv2.utils, "logging")  # OpenCV 4 cannot be told to be silent
            if suffix in (".png", ".jpg") or silent:
                assert capfd.readouterr() == ("", "")


def test_other_images_are_refused_with_what_they_are(tmp_path, picture):
    for pixels, said in (
        (picture[..., 0], r"got a gray one.*three channels"),
        (picture.astype(np.uint16) * 200, r"got more or fewer bits.*8 bits"),
        (np.dstack([picture, picture[..., :1]]), r"transparency \(an alpha channel\).*Save it without"),
    ):
        with pytest.raises(DataError, match=said):
            read_image(write(tmp_path / "image.png", pixels))


def test_an_opaque_alpha_channel_is_left_out_and_a_palette_refused(tmp_path, picture):
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    path = write(tmp_path / "opaque.png", opaque)
    np.testing.assert_array_equal(read_image(path), picture[..., ::-1])
    rows, chunks = zlib.compress(b"\0\0\1\2\3" * 3), []
    size = struct.pack(">IIBBBBB", 4, 3, 8, 3, 0, 0, 0)
    for name, data in ((b"IHDR", size), (b"PLTE", bytes(range(12))), (b"IDAT", rows), (b"IEND", b"")):
        chunks += [struct.pack(">I", len(data)), name, data, struct.pack(">I", zlib.crc32(name + data))]
    (tmp_path / "palette.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))
    with pytest.raises(DataError, match=r"got a palette of up to 256 colors.*full color"):
        read_image(tmp_path / "palette.png")


def test_what_is_no_image_is_refused_and_a_recording_told_where_to_go(tmp_path):
    for name, content in (("text.png", b"hello"), ("empty.png", b""), ("s.mcap", b"not"), ("s.MP4", b"not")):
        (tmp_path / name).write_bytes(content)
    for name, text in (
        ("text.png", "no image"),
        ("empty.png", "is empty"),
        ("missing.png", "No file"),
        (".", "got the folder"),
        ("s.mcap", "gelform batch"),
        ("s.MP4", "gelform batch"),
    ):
        with pytest.raises(DataError, match=text):
            read_image(tmp_path / name)


def test_sensor_toml(tmp_path):
    path = tmp_path / "sensor.toml"
    view = '[view]\nframe_shape = [480, 640]\nflip = "x"\n'
    path.write_text(f'name = "Gel é"\nmm_per_px = 0.05\nserial = "A1"\n{view}', "utf-8")
    wanted = SensorSettings("Gel é", 0.05, serial="A1", view=View((480, 640), flip="x"))
    assert read_sensor_toml(path) == wanted
    path.write_text('name = "G"\nmm_per_px = 0.1\n[camera]\nexposure = 50\nfourcc = "MJPG"\n')
    assert read_sensor_toml(path).camera == {"exposure": 50, "fourcc": "MJPG"}
    for text, wanted in {
        '0.05\nmake = "digit"': SensorSettings("G", 0.05, make="digit"),
        "[0.05, 0.04]": SensorSettings("G", (0.05, 0.04)),
        "[0.05, 0.05]": SensorSettings("G", 0.05),
        "1\nmm_per_px_sigma = 0.01": SensorSettings("G", 1.0, mm_per_px_sigma=0.01),
    }.items():
        path.write_text(f'name = "G"\nmm_per_px = {text}\n')
        assert read_sensor_toml(path) == wanted


VALID = 'name = "G"\nmm_per_px = 0.05\n'


def test_wrong_sensor_toml(tmp_path):
    for text, said in (
        ('name = "G"', "mm_per_px missing"),
        ("mm_per_px = 0.05", "name missing"),
        ('name = "G"\nmm_per_px = 0', r"mm_per_px > 0, got 0"),
        ('name = "G"\nmm_per_px = "x"', "mm_per_px as a number"),
        ('name = "G"\nmm_per_px = "0.1"', "mm_per_px as a number, got '0.1'"),
        ('name = "G"\nmm_per_px = true', "mm_per_px as a number, got True"),
        ('name = "G"\nmm_per_px = 1e300', "got 1e[+]300"),
        (VALID + 'make = "Mini"', "make as one of gelsight-mini, digit, got 'Mini'"),
        (VALID + "make = 3", "make as text"),
        ('name = "G"\nmm_per_px = [0.05]', "as two, .x, y., got 1"),
        ('name = "G"\nmm_per_px = [0.05, 15.8]', "If these are pixels per mm"),
        ('name = "G"\nmm_per_px = 15.8', r"If these are pixels per mm, give 1/15.8 = 0.06329"),
        (VALID + 'mm_per_px_sigma = "1"', "mm_per_px_sigma as a number"),
        (VALID + "gel_thickness_mm = 0", "gel_thickness_mm between 0.05 and 50, got 0"),
        (VALID + "scale = 3", "got scale"),
        (VALID + "serial = 3", "serial as text"),
        (VALID + "view = 3", r"table \[view\]"),
        (VALID + '[view]\nflop = "x"', "got flop"),
        (VALID + "camera = 3", r"table \[camera\]"),
        (VALID + "[camera]\ngain = true", r"gain of \[camera\] as a number"),
        (VALID + "[camera]\ngain = nan", r"gain of \[camera\] as a number"),
        ("name = ", "no TOML"),
        (VALID + f"serial = {'9' * 5000}", "no TOML"),
    ):
        path = tmp_path / "sensor.toml"
        path.write_text(text)
        with pytest.raises(DataError, match=said) as caught:
            read_sensor_toml(path)
        assert "sensor.toml" in str(caught.value)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match="no text in UTF-8"):
        read_sensor_toml(path)


@pytest.fixture
def rests(sensor, tmp_path):
    """Five untouched frames in a folder."""
    rng = np.random.default_rng(8)
    images = [simulate_background(sensor, rng) for _ in range(5)]
    (tmp_path / "background").mkdir()
    for k, image in enumerate(images):
        save_picture(tmp_path / "background" / f"{k}.png", image)
    return tmp_path / "background"


def test_one_image_is_itself_a_folder_is_averaged_and_no_background_refused(rests, tmp_path):
    images = [gelform.read_image(path) for path in sorted(rests.iterdir())]
    one = read_background(rests / "0.png")
    assert one.dtype == np.uint8
    np.testing.assert_array_equal(one, images[0])
    averaged = gelform.background_from_frames(images).background
    for paths in (rests, sorted(rests.iterdir())):
        np.testing.assert_array_equal(read_background(paths), averaged)
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="empty, got none"):
        read_background(tmp_path / "empty")
    save_picture(rests / "9.png", np.zeros((20, 30, 3), dtype=np.uint8))
    with pytest.raises(DataError, match=r"gel at rest in .*20x30"):
        read_background(rests)


def test_of_several_stacks_one_is_held_at_a_time(tmp_path, monkeypatch):
    held, page = WeakSet(), np.full((24, 32, 3), 100, np.uint8)
    for name in "abc":
        cv2.imwritemulti(str(tmp_path / f"{name}.tif"), [page] * 3)

    def opened(path):
        assert not held
        image, count = images_of_stack(path)
        held.add(image)
        return image, count

    monkeypatch.setattr("gelform.sensors.files.images_of_stack", opened)
    np.testing.assert_array_equal(read_background(tmp_path), page)


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


@pytest.mark.parametrize(
    "name", ["frame0.jpg", "ref.png", "my_bg.png", "Blank.bmp", "rest", "ambient.npy", "no-contact.png"]
)
def test_the_likely_background_is_named(tmp_path, name):
    folder = tmp_path / "presses"
    folder.mkdir()
    for other in ("restaurant.png", "0001.png", "reference.txt", "preflight.jpg"):
        (folder / other).write_bytes(b"")
    with pytest.raises(DataError, match=r"expected background\.png, .* Take one, or name it"):
        background_in(folder)
    for place in (folder, tmp_path):  # beside the presses, or above them
        path = place / name
        path.write_bytes(b"") if path.suffix else path.mkdir()
        said = rf"By its name it is \S*{path.name}\. .* \(--background \S*{path.name}\)"
        with pytest.raises(DataError, match=said):
            background_in(folder)
        path.unlink() if path.suffix else path.rmdir()
