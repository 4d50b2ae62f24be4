"""Input that leaves something undetermined, at the public doors: the same outcome whatever the processor rounds to.

Motion has its own such input in `motion/test_between.py`.

Files of a terabyte that take no room on a disk: each is named, and no memory is asked for.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import find_contact
from gelform.calibration.presses.folder import read_presses
from gelform.cli import main
from gelform.errors import CalibrationError, DataError, GelformError
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.exchange.importers import is_taxim_forward, read_lut, read_taxim_forward
from gelform.foundations.files import write_npz
from gelform.sensors.files import read_sensor_toml
from gelform.sensors.simulated import read_simulated_sensor
from hostile.doors import (
    CHANGE,
    FOLDER_OF_PRESSES,
    FORCE,
    IMAGE,
    REST,
    RESULT,
    UNTOUCHED,
    called,
    fresh_folder,
    right_arguments,
)
from hostile.outcome import judge
from made.images import image_of_dots
from made.small_gel import MM_PER_PX, SHAPE, Touch, calibration, image_of, save, stepping

FLAT = np.full((*SHAPE, 3), 128, np.uint8)
RAMP = np.broadcast_to(np.linspace(60, 200, SHAPE[1])[None, :, None], FLAT.shape).astype(np.uint8)
ONE_PIXEL = FLAT.copy()
ONE_PIXEL[30, 40] = 255
IMAGES = {
    "flat": (FLAT, FLAT), "black": (0 * FLAT, 0 * FLAT), "one frame twice": (IMAGE, IMAGE), "one pixel": (ONE_PIXEL, FLAT),
    "gray": (IMAGE[..., :1].repeat(3, 2), REST[..., :1].repeat(3, 2)), "a ramp": (RAMP, RAMP), "flat now": (FLAT, REST),
    "2 px": (IMAGE[:2, :2], REST[:2, :2]), "25 rows": (IMAGE[:25], REST[:25]),
    "a row": (IMAGE[30:31], REST[30:31]), "a column": (IMAGE[:, 40:41], REST[:, 40:41]),
}  # fmt: skip
OUTCOMES = {
    "markers_from_image": {},
    "color_change_from_image": {},
    "registration_from_image": {"a row": "error", "a column": "error"},
}
FRAMES = dict.fromkeys(
    ("flat", "black", "one frame twice", "flat now", "a ramp", "a row", "a column"), "finding"
)
FRAMES |= {"one pixel": "right", "2 px": "right"}
LINES = {
    "a row": (1.0, 0.0),
    "a slanted line": (0.1, 0.37),
    "a line far away": (1 / 3, 1 / 7),
    "one place": (0.0, 0.0),
}
TIMES = np.linspace(0.1, 1, 12)
PUSHED = [
    gelform.touch_from_dots(np.array([[0.0, 0], [2, 0], [0, 2], [2, 2]]), k * np.ones((4, 2))) for k in TIMES
]
ODD_LOADS = {
    "huge": (1e300, 1e300), "infinite": (np.inf, 1.0), "NaN": (np.nan, 1.0), "of three parts": (1.0, 2.0, 3.0),
    "a number": 1.0, "words": ("a", "b"), "nested": [[1, 2]], "one part": (1.0,),
}  # fmt: skip
PLACES = {"one place": [(40, 30)] * 6, "the border": [(0, 30), (79, 30), (40, 0), (40, 63), (0, 0), (79, 63)]}


def calibrated(images: list[np.ndarray], rest: np.ndarray = UNTOUCHED) -> gelform.Calibration:
    presses = {
        **FOLDER_OF_PRESSES, "background": rest, "images": images, "ball_diameters_mm": [8.0] * len(images),
        "centers_px": None, "contact_radii_px": None,
    }  # fmt: skip
    folder = save_press_folder(fresh_folder(), **presses)
    return gelform.calibrate(gelform.read_presses(folder, mm_per_px=MM_PER_PX), color_model="lambertian")


@pytest.mark.linear_algebra
@pytest.mark.parametrize("what", IMAGES)
@pytest.mark.parametrize("name", OUTCOMES)
def test_an_image_that_shows_nothing(name, what):
    image, rest = IMAGES[what]
    asked = {"image": image, "background": rest.astype(np.float32)}
    assert judge(f"{name} of {what}", lambda: called(name, asked)) == OUTCOMES[name].get(what, "right")


@pytest.mark.linear_algebra
@pytest.mark.parametrize("what", FRAMES)
@pytest.mark.parametrize("known", [calibration, stepping])
def test_a_frame_that_shows_nothing(known, what):
    image, rest = IMAGES[what]
    seen = replace(known(), background=rest.astype(np.float32), image_shape=rest.shape[:2])
    assert judge(what, lambda: gelform.Reconstructor(seen)(image)) == FRAMES[what]


@pytest.mark.linear_algebra
@pytest.mark.parametrize("rows", [1, 2, 4, 10])
def test_a_motion_of_the_camera_by_a_few_rows(rows):
    """Those do not determine how light changes down the image."""
    touched = np.ones(SHAPE, bool)
    touched[30 : 30 + rows] = False
    assert judge("registered", lambda: gelform.registration_from_image(IMAGE, REST, touched)) == "right"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("what", LINES)
def test_dots_in_a_line_tell_no_tilt(what):
    along = np.arange(6.0)[:, None] * LINES[what] + (1 / 3, 1e3)
    assert judge(what, lambda: gelform.touch_from_dots(along, 0.1 * np.sin(along))) == "error"
    image = image_of_dots(12 * (along - along[0]) + 12)
    assert judge(what, lambda: gelform.markers_from_image(image, image.astype(np.float32))) == "right"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("what", ODD_LOADS)
def test_loads_that_are_no_numbers(what):
    loads = [gelform.Load("ball", shear_n=ODD_LOADS[what])] * len(TIMES)
    assert judge(what, lambda: gelform.calibrate_force(PUSHED, loads)) == "error"
    assert judge(what, lambda: gelform.evaluate_force(FORCE, PUSHED, loads)) == "error"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("touches", [PUSHED, PUSHED[:1] * len(TIMES)])
def test_forces_of_dots_that_do_not_turn(touches):
    """Turn and tilt determine nothing; nor does one motion alone."""
    loads = [gelform.Load("ball", shear_n=(k, k)) for k in TIMES]
    model = gelform.calibrate_force(touches, loads)
    assert np.abs(model.shear.weights).max() < 10
    assert np.abs(np.array(model.shear.weights)[:, 2:]).max() < 1e-9


@pytest.mark.linear_algebra
@pytest.mark.parametrize("what", ["flat", "constant", *PLACES])
def test_presses_that_determine_no_calibration(what):
    constant = [np.full_like(UNTOUCHED, 100 + k) for k in range(6)]
    images = {"flat": [image_of(None)] * 6, "constant": constant} | {
        name: [image_of(Touch(x_px=x, y_px=y, seed=k)) for k, (x, y) in enumerate(places)]
        for name, places in PLACES.items()
    }
    rest = constant[0] if what == "constant" else UNTOUCHED
    if what == "the border":  # half of each ball is enough, around the whole frame
        assert calibrated(images[what], rest).held_out["normal_free_deg"] < 1.5
        return
    assert judge(what, lambda: calibrated(images[what], rest)) == "error"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("shape", [(1, 80), (64, 1), (10, 80)])
def test_images_without_room_for_a_contact(shape):
    small = CHANGE[: shape[0], : shape[1]]
    with pytest.raises(gelform.GelformError, match=f"at least 24 px .* got {shape[0]}x{shape[1]} px"):
        find_contact(small)


@pytest.mark.linear_algebra
def test_a_mosaic_of_results_without_contact():
    none = replace(RESULT, contact=np.zeros(SHAPE, bool))
    assert judge("mosaic", lambda: gelform.mosaic([none, none], [np.eye(4)] * 2)) == "error"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("scale", [1.0, 1e3, 1e-5])
def test_a_perspective_that_cannot_be_undone(scale):
    """Its determinant is a rounding error, which is no measure by itself."""
    flattened = scale * np.array([[0.1, 0.7, 0], [0.3, 2.1, 0], [0, 0, 1]])
    for outcome, perspective in (("error", flattened), ("right", scale * np.eye(3))):
        asked = right_arguments("Lens") | {"perspective": tuple(perspective.ravel())}
        assert judge(outcome, lambda asked=asked: called("Lens", asked)) == outcome


TERABYTE = 2**40
STARTS = {
    ".png": b"\x89PNG\r\n\x1a\n",
    ".jpg": b"\xff\xd8\xff\xe0",
    ".bmp": b"BM",
    ".h5": b"\x89HDF\r\n\x1a\n",
    ".csv": b"image,ball_diameter_mm\n",
    ".npy": b"\x93NUMPY",
    "": b"",
}


def sparse(path, start=b""):
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        file.write(start)
        try:
            file.truncate(TERABYTE)
        except OSError as problem:
            pytest.skip(f"no sparse files of a terabyte here: {problem.strerror}")
    return path


@pytest.mark.parametrize("ending", STARTS)
def test_info_names_the_size(tmp_path, capsys, ending):
    path = sparse(tmp_path / f"a{ending}", STARTS[ending])
    with pytest.raises(SystemExit) as stopped:
        main(["info", str(path)])
    said = capsys.readouterr().err
    assert stopped.value.code == 1
    # An array and HDF5 are read from the disk where they are used: what is refused is their header.
    of_header = {".npy": "is no array file", ".h5": "HDF5"}.get(ending, "of 1.1e+06 MB")
    assert of_header in said


@pytest.mark.parametrize(
    ("read", "name"),
    [
        (gelform.read_image, "a.png"),
        (gelform.load_calibration, "a.npz"),
        (gelform.load_result, "a.npz"),
        (read_sensor_toml, "sensor.toml"),
        (read_simulated_sensor, "sensor.toml"),
        (lambda path: read_lut(path, np.zeros((48, 64, 3), np.float32)), "table.npy"),
        (read_taxim_forward, "polycalib.npz"),
        (lambda path: read_presses(path.parent, sensor="digit"), "presses.csv"),
        (lambda path: read_presses(path.parent, sensor="digit"), "catalog.csv"),
        (lambda path: read_presses(path, sensor="digit"), "dataPack.npz"),
    ],
)
def test_readers_refuse_it(tmp_path, read, name):
    path = sparse(tmp_path / name)
    save(tmp_path / "background.png", image_of(None))
    with pytest.raises(GelformError, match=name.partition(".")[0]):
        read(path)


def test_an_archive_that_declares_too_much_is_not_unpacked(tmp_path):
    """A label of a press whose zeros were compressed to a thousandth."""
    save(tmp_path / "background.png", image_of(None))
    (tmp_path / "one").mkdir()
    np.savez_compressed(tmp_path / "one/label.npz", center=np.zeros(2**26), radius=5.0)
    (tmp_path / "catalog.csv").write_text("experiment_reldir,diameter(mm)\none,5\n")
    assert (tmp_path / "one/label.npz").stat().st_size < 2**20
    with pytest.raises(DataError, match=r"label\.npz declares 536\.9 MB; the label of a press has at most"):
        read_presses(tmp_path, sensor="digit")
    assert not is_taxim_forward(tmp_path / "one/label.npz")
    assert not is_taxim_forward(sparse(tmp_path / "a.npy", STARTS[".npy"]))


def test_a_sparse_archive_of_ours_is_refused(tmp_path):
    path = tmp_path / "cal.npz"
    write_npz(path, {"a": np.zeros(3)}, {}, kind="thing", version=1)
    with path.open("r+b") as file:
        file.truncate(TERABYTE)
    with pytest.raises(CalibrationError, match=r"cal\.npz is truncated or damaged"):
        gelform.load_calibration(path)


@pytest.mark.parametrize("command", ["batch", "reconstruct"])
def test_one_such_picture_among_others_is_its_own_error(tmp_path, capsys, command):
    images = tmp_path / "in"
    for k in range(3):
        save(images / f"{k}.png", image_of(Touch(seed=k)))
    bad = sparse(images / "1.png", STARTS[".png"])
    calibration().save(tmp_path / "cal.npz")
    given = [images] if command == "batch" else sorted(images.iterdir())
    with pytest.raises(SystemExit) as stopped:
        main([command, *map(str, given), "-c", str(tmp_path / "cal.npz"), "-o", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert stopped.value.code == 1
    assert "1.png" in said
    if command == "reconstruct":
        assert f"got {bad} of 1.1e+06 MB" in said
        assert {path.stem for path in (tmp_path / "out").glob("*.npz")} == {"0", "2"}
    else:
        assert len(list((tmp_path / "out").rglob("*.npz"))) == 2


IN_LITTLE_MEMORY = """
import resource, sys
from pathlib import Path
import gelform
from gelform.batch import run_batch
here = Path(sys.argv[1])
calibration = gelform.load_calibration(here / "cal.npz")
run_batch(here / "first", calibration, here / "before")
taken = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmSize"))
resource.setrlimit(resource.RLIMIT_AS, (1024 * taken + 20 * 2**20,) * 2)
print(run_batch(here / "in", calibration, here / "out").tally)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits a process's memory")
def test_a_frame_without_memory_is_its_own_error(tmp_path):
    """A process that may take 20 MB more meets a picture of 36 MB."""
    for name in ("first/0.png", "in/0.png", "in/2.png"):
        save(tmp_path / name, image_of(Touch()))
    save(tmp_path / "in/1.png", np.zeros((3000, 4000, 3), np.uint8))
    calibration().save(tmp_path / "cal.npz")
    ran = subprocess.run(
        [sys.executable, "-c", IN_LITTLE_MEMORY, tmp_path], capture_output=True, text=True, check=True
    )
    assert "memory" in ran.stdout.lower(), ran.stdout
    assert len(list((tmp_path / "out").rglob("*.npz"))) == 2
