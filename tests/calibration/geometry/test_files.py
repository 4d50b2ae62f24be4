"""Values change, everything else in the text stays as the user wrote it.

What was measured is written where `read_presses` finds it, and nothing that was there is lost.
"""

import shutil
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.geometry.files import (
    edited_toml,
    read_setup,
    save_crosstalk,
    save_grid_view,
    save_scale,
)
from gelform.calibration.geometry.measured import Crosstalk
from gelform.calibration.geometry.scale import GridView, Scale
from gelform.errors import CalibrationError, DataError
from gelform.image.view import Lens, View, image_from_frame
from gelform.sensors.files import read_sensor_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


TEXT = """# my sensor, bought in May
name = "a # b"   # not a comment: the first
mm_per_px = 0.05 # from the seller

[view]   # measured
crop = [
  1, 2,  # left, top
  3, 4,
]
flip = "x"

# the end
"""


def test_comments_order_and_other_keys_stay():
    edited = edited_toml(
        TEXT, {(): {"mm_per_px": 0.0634, "mm_per_px_sigma": 1e-5}, ("measured",): {"scale": 'a "b"'}}
    )
    assert edited == (
        TEXT.replace("0.05 #", "0.0634 #").replace("seller\n", "seller\nmm_per_px_sigma = 1e-05\n")
        + '\n[measured]\nscale = "a \\"b\\""\n'
    )


def test_a_table_and_what_is_below_it_can_be_dropped():
    text = TEXT + "[view.lens]\ncamera = [1, 2]\n[other]\nx = 1\n"
    edited = edited_toml(text, {("view",): {"flip": "y"}}, drop=[("view",)])
    content = tomllib.loads(edited)
    assert content["view"] == {"flip": "y"}
    assert content["other"] == {"x": 1}
    assert edited.startswith("# my sensor")


def test_keys_are_edited_however_they_are_written():
    for text in ("view.flip = 'x'\n", "view = { flip = 'x' }\n", "[view]\nflip = 'x'\n"):
        assert tomllib.loads(edited_toml(text, {("view",): {"flip": "y"}})) == {"view": {"flip": "y"}}
    for text in ("view = 3\n", "view = \n"):
        with pytest.raises(ValueError, match="cannot be written into it"):
            edited_toml(text, {("view",): {"flip": "y"}})


def test_line_ends_of_all_kinds_stay():
    for text in ("a = 1  # one\u2028two\r\nb = 2\r\n", "a = 1", "\n\na = 1\n\n", "# only words"):
        edited = edited_toml(text, {("t",): {"x": 1}})
        assert edited.startswith(text)
        assert tomllib.loads(edited)["t"] == {"x": 1}


SCALE = Scale(0.0634, 0.0004, "a punch of 5 mm")
LENS = Lens((170.0, 170.0, 87.5, 65.5), (-0.1, 0.01))
GRID = GridView(View((132, 176), (4.0, 3.0, 168.0, 126.0), lens=LENS), SCALE, 0.05, 0.003, 54)
MATRIX = ((1.0, 0.1, 0.0), (0.05, 1.0, 0.0), (0.0, 0.02, 1.0))


@pytest.fixture
def place(folder, tmp_path):
    """A copy of the shared press folder, its settings with a comment and a serial."""
    copy = shutil.copytree(folder, tmp_path / "presses")
    (copy / "sensor.toml").write_text('name = "mine"\nmm_per_px = 0.1153  # by eye\nserial = "7"\n')
    return copy


def test_the_scale_is_read_again_with_its_source(place):
    assert save_scale(SCALE, place) == place / "sensor.toml"
    presses = gelform.read_presses(place)
    assert (presses.mm_per_px, presses.mm_per_px_sigma) == (0.0634, 0.0004)
    assert presses.geometry.scale_source == "a punch of 5 mm"
    assert presses.serial == "7"
    assert "# by eye" in (place / "sensor.toml").read_text()
    given = gelform.read_presses(place, mm_per_px=0.1)
    assert (given.mm_per_px_sigma, given.geometry.scale_source) == (None, "")


def test_the_lens_is_read_again_and_can_be_measured_anew(place):
    save_grid_view(GRID, place / "sensor.toml")
    presses = gelform.read_presses(place)
    assert presses.view == GRID.view
    assert presses.image_shape == (126, 168)
    assert presses.geometry.lens == GRID.describe()
    other = replace(GRID, view=replace(GRID.view, crop=None))
    save_grid_view(other, place)
    assert read_sensor_toml(place / "sensor.toml").view == other.view


def test_a_crop_of_another_kind_is_not_overwritten(place):
    (place / "sensor.toml").write_text(
        'name = "mine"\nmm_per_px = 0.1\n[view]\nframe_shape = [132, 176]\ncrop = [0, 0, 100, 100]\n'
    )
    before = (place / "sensor.toml").read_bytes()
    with pytest.raises(DataError, match=r"Take the \[view\] out"):
        save_grid_view(GRID, place)
    assert (place / "sensor.toml").read_bytes() == before


def test_the_crosstalk_is_read_again(place):
    spread = ((0.0, 0.01, 0.0),) * 3
    save_crosstalk(Crosstalk(MATRIX, spread), place)
    assert gelform.read_presses(place).geometry.crosstalk == Crosstalk(MATRIX, spread)


def test_a_new_file_is_named_for_its_folder(tmp_path):
    save_scale(SCALE, tmp_path)
    assert read_sensor_toml(tmp_path / "sensor.toml").name == tmp_path.name


def test_an_imported_calibration_gets_its_scale_and_one_of_presses_keeps_its_own(calibration, tmp_path):
    path = tmp_path / "cal.npz"
    calibration.save(path)
    with pytest.raises(CalibrationError, match=r"read off balls at 0\.1153 mm/px"):
        save_scale(SCALE, path)
    with pytest.raises(CalibrationError, match="calibrate again"):
        save_grid_view(GRID, path)
    assert gelform.load_calibration(path).digest == calibration.digest
    imported = replace(calibration, mm_per_px=None, mm_per_px_sigma=None, training_digests=())
    imported.save(path, overwrite=True)
    save_scale(SCALE, path)
    loaded = gelform.load_calibration(path)
    assert loaded.mm_per_px == 0.0634
    assert loaded.settings["scale_source"] == "a punch of 5 mm"
    np.testing.assert_array_equal(loaded.background, calibration.background)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("measured = 3", r"table \[measured\]"),
        ("[measured]\nlengths = 3", "lengths"),
        ("[measured]\nscale = 3", "scale of .measured. as str"),
        ("[measured]\ncrosstalk = [1, 2]", "3x3"),
        ("[measured]\ncrosstalk = [[nan,0,0],[0,1,0],[0,0,1]]", "3x3"),
    ],
)
def test_wrong_tables_are_refused(tmp_path, table, said):
    (tmp_path / "sensor.toml").write_text(f'name = "x"\nmm_per_px = 0.1\n{table}\n')
    with pytest.raises(DataError, match=said):
        read_sensor_toml(tmp_path / "sensor.toml")


def test_a_folder_and_its_settings_say_the_same(folder, presses):
    for place in (folder, folder / "sensor.toml"):
        setup = read_setup(place)
        np.testing.assert_array_equal(setup.background, presses.background)
        np.testing.assert_array_equal(setup.image(folder / presses.presses[0].name), presses.presses[0].image)


def test_a_folder_with_a_view(folder, tmp_path):
    view = View((132, 176), (10, 12, 100, 80), flip="x")
    (tmp_path / "background.png").write_bytes((folder / "background.png").read_bytes())
    (tmp_path / "sensor.toml").write_text(
        'name = "x"\nmm_per_px = 1\n[view]\nframe_shape = [132, 176]\ncrop = [10, 12, 100, 80]\nflip = "x"\n'
    )
    setup = read_setup(tmp_path)
    frame = gelform.read_image(tmp_path / "background.png")
    np.testing.assert_array_equal(setup.background, image_from_frame(frame, view))
    np.testing.assert_array_equal(setup.image(tmp_path / "background.png"), image_from_frame(frame, view))


def test_a_profile_gives_the_view_of_a_bare_folder(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "background.png"), frame)
    assert read_setup(tmp_path, sensor="gelsight-mini").background.shape == (240, 320, 3)
    assert read_setup(tmp_path).background.shape == (480, 640, 3)


def test_a_calibration_has_both(calibration, folder, tmp_path):
    replace(calibration, report=None).save(tmp_path / "cal.npz")
    setup = read_setup(tmp_path / "cal.npz")
    np.testing.assert_array_equal(setup.background, calibration.background)
    today = read_setup(tmp_path / "cal.npz", background=folder / "background.png")
    assert today.background.shape == calibration.background.shape


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(DataError, match="which is not there"):
        read_setup(tmp_path / "nowhere")
    with pytest.raises(DataError, match="No background"):
        read_setup(tmp_path)


def test_one_scale_does_not_replace_a_pair(place):
    (place / "sensor.toml").write_text('name = "mine"\nmm_per_px = [0.1, 0.08]\n')
    with pytest.raises(DataError, match="pixels that are not square"):
        save_scale(SCALE, place)
    save_grid_view(GRID, place)
    assert read_sensor_toml(place / "sensor.toml").mm_per_px == SCALE.mm_per_px, "a lens makes square pixels"
