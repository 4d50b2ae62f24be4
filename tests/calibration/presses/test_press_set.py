"""A set of presses: which scale and view it gets from what was asked, beside the data and known by name."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.presses.press_set import (
    Listed,
    ReadOptions,
    diameter,
    number,
    press_from_frame,
    table_rows,
)
from gelform.errors import DataError, SensorError
from gelform.image.view import View
from gelform.sensors.files import SensorSettings
from gelform.sensors.profiles import PROFILES

MINI = PROFILES["gelsight-mini"]


@pytest.fixture
def beside(tmp_path):
    (tmp_path / "sensor.toml").write_text(
        'name = "mine"\nmm_per_px = 0.07\nmm_per_px_sigma = 0.001\n[measured]\nscale = "a punch"\nlens = "a grid"\n'
    )
    return tmp_path


def test_the_scale_that_is_given_goes_first(beside):
    asked = ReadOptions(mm_per_px=0.05).settings(beside)
    assert (asked.name, asked.mm_per_px, asked.mm_per_px_sigma) == ("mine", 0.05, None)
    assert asked.measured == {"lens": "a grid"}, "what measured the other scale is not this one's source"


def test_then_what_lies_beside_the_data_then_what_they_know_then_the_profile(beside, tmp_path):
    known = SensorSettings("known", 0.06)
    assert ReadOptions(sensor="gelsight-mini").settings(beside, known).mm_per_px == 0.07
    (tmp_path / "other").mkdir()
    assert ReadOptions(sensor="gelsight-mini").settings(tmp_path / "other", known) == replace(
        known, make="gelsight-mini"
    )
    by_profile = ReadOptions(sensor="gelsight-mini").settings(tmp_path / "other")
    assert (by_profile.name, by_profile.mm_per_px) == (MINI.name, MINI.mm_per_px)


def test_the_view_that_is_asked_for_goes_first():
    own = SensorSettings("mine", 0.07, view=View((480, 640), flip="x"))
    frame = (480, 640)
    assert ReadOptions(crop=(1, 2, 30, 40)).view(own, frame) == View(frame, (1, 2, 30, 40))
    assert ReadOptions(sensor="gelsight-mini").view(own, frame) == own.view
    plain = SensorSettings("mine", 0.07)
    assert ReadOptions().view(plain, frame).is_identity
    assert ReadOptions(sensor="gelsight-mini").view(plain, frame) == MINI.view(frame)


def test_a_ball_and_a_scale_have_to_be_known(tmp_path):
    with pytest.raises(DataError, match=r"No scale for .*--mm-per-px.*gelform scale"):
        ReadOptions().settings(tmp_path)
    assert ReadOptions(ball_diameter_mm=6.35).ball("x") == 6.35
    with pytest.raises(DataError, match=r"x: which ball pressed\?.*--ball-diameter-mm"):
        ReadOptions().ball("x")


def test_a_press_is_its_frame_through_the_view():
    frame = np.random.default_rng(0).integers(0, 256, (4, 6, 3), dtype=np.uint8)
    press = press_from_frame(Listed("a.png", 6.0), frame, View((4, 6), flip="x"))
    np.testing.assert_array_equal(press.image, frame[:, ::-1])
    again = press_from_frame(Listed("b.png", 6.0), frame[:, ::-1], View())
    assert press.digest == again.digest != press_from_frame(Listed("a.png", 6.0), frame, View()).digest


def test_a_subset_is_of_the_same_sensor_and_a_pitch_that_nothing_has_is_refused(presses):
    some = presses.subset([2, 0])
    assert [press.name for press in some.presses] == [presses.presses[2].name, presses.presses[0].name]
    assert some.image_shape == presses.image_shape
    assert some.background is presses.background
    for pitch in (0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="mm_per_px > 0"):
            replace(presses, mm_per_px=pitch)


COLUMNS = ("image", "ball_diameter_mm")


def table(tmp_path, text):
    path = tmp_path / "presses.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_rows_come_with_their_line(tmp_path):
    path = table(tmp_path, "\ufeffimage,ball_diameter_mm,note\r\n a.png , 6 ,\r\n\r\nb.png,7,x\r\n")
    (where, first), (_, second) = table_rows(path, COLUMNS)
    assert first == {"image": "a.png", "ball_diameter_mm": "6", "note": ""}
    assert second["image"] == "b.png"
    assert where.endswith("presses.csv, line 2")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("image,size\na.png,6\n", r"got image, size: ball_diameter_mm missing"),
        ("", "got none"),
        (b"\xff\xfe\x00", "no table"),
        ("image,ball_diameter_mm\na.png,6,35\n", r"2 fields, got 3 .*line 2.* decimal comma.* 6\.35"),
        (
            "image,ball_diameter_mm,note,x,y\na.png,6,35\n",
            r"5 fields, got 3 .*line 2.* decimal comma.* 6\.35",
        ),
        ("image,ball_diameter_mm\n0.png,6\na.png,6,,,\n", r"2 fields, got 5 .*line 3"),
    ],
)
def test_what_is_no_such_table_is_refused(tmp_path, text, said):
    with pytest.raises(DataError, match=said):
        list(table_rows(table(tmp_path, text), COLUMNS))


def test_numbers_are_finite_and_balls_have_a_size():
    for text in ("nan", "inf", "six", "", "1e999"):
        with pytest.raises(DataError, match=r"radius as a .*number, got .* \(line 3\)"):
            number(text, "radius", "line 3")
    for text in ("0", "-6", "300", "nan"):
        with pytest.raises(DataError, match="line 3"):
            diameter(text, "line 3")
    assert diameter("6.35", "line 3") == 6.35


def test_a_make_is_named_beside_the_data_asked_for_or_the_start_of_a_name(beside, presses):
    named = beside / "sensor.toml"
    assert ReadOptions().settings(beside).make == ""
    assert ReadOptions(sensor="gelsight-mini").settings(beside).make == "gelsight-mini"
    named.write_text('name = "my Mini"\nmm_per_px = 0.06\nmake = "digit"\n')
    assert ReadOptions().settings(beside).make == "digit"
    assert ReadOptions(sensor="gelsight-mini").settings(beside).make == "gelsight-mini"
    with pytest.raises(SensorError, match="gelsight-mini, digit, got 'mini'"):
        ReadOptions(sensor="mini").settings(beside)
    assert replace(presses, sensor_name="my Mini", make="digit").make == "digit"
    assert replace(presses, sensor_name="GelSight Mini 3", make=None).make == "gelsight-mini"
    assert replace(presses, sensor_name="my Mini", make=None).make is None


def test_a_make_beside_the_data_has_its_view_where_the_scale_is_its_own():
    frame = (480, 640)
    mini = SensorSettings("my Mini", 0.0634, make="gelsight-mini")
    assert ReadOptions().view(mini, frame) == MINI.view(frame)
    cut_by_the_user = replace(mini, mm_per_px=0.0317)
    assert ReadOptions().view(cut_by_the_user, frame).is_identity


def test_images_of_a_make_carry_the_view_of_its_camera(presses):
    images = replace(presses, presses=(), background=np.zeros((240, 320, 3), np.float32), mm_per_px=0.0634)
    assert images.camera_view.is_identity
    mini = replace(images, make="gelsight-mini")
    assert mini.camera_view == MINI.view((2464, 3280))
    own = View((300, 400), image_shape=(240, 320))
    assert replace(mini, view=own).camera_view == own


def test_a_gel_wider_or_narrower_than_any_is_refused(presses):
    for pitch, width in ((0.9, 158), (0.0126, 2.22)):
        named = rf"a gel between 3 and 150 mm wide, got 176 px of {pitch} mm: {width} mm"
        with pytest.raises(ValueError, match=named):
            replace(presses, mm_per_px=pitch)
    with pytest.raises(ValueError, match=r"gel of a GelSight Mini between 10.1 and 40.6 mm wide, got 176 px"):
        replace(presses, mm_per_px=0.0126, make="gelsight-mini")


def test_presses_show_themselves_in_a_line(presses):
    shown = repr(presses)
    assert shown.startswith(f"Presses({presses.folder}: {len(presses.presses)} of balls of ")
    assert f"{presses.mm_per_px:g} mm per pixel)" in shown
    assert len(shown) < 150 + len(presses.folder)
    press = presses.presses[0]
    assert repr(press) == f"Press({press.name}, ball {press.ball_diameter_mm:g} mm)"
    assert repr(replace(press, label=(1, 2, 3))).endswith(" mm, labeled)")
