"""A set of presses: which scale and view it gets from what was asked, beside the data and known by name.

Other packages' folders give the same presses as a press folder of the same images.

A press folder that grows: what was taken is there, a miss is not taken.
"""

import io
import json
import shutil
import zipfile
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.guide import TakenPresses
from gelform.calibration.presses.folder import ReadOptions, kind_of_presses, read_presses
from gelform.calibration.presses.press_set import Press, presses_from_settings, table_rows
from gelform.errors import DataError, SensorError
from gelform.exchange.exporters.press_folder import toml_of_settings
from gelform.image.view import View
from gelform.sensors.files import SensorSettings, read_sensor_toml
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
    named = ReadOptions(sensor="gelsight-mini").settings(tmp_path / "other", known)
    assert named == replace(known, make="gelsight-mini")
    by_profile = ReadOptions(sensor="gelsight-mini").settings(tmp_path / "other")
    own = SensorSettings(MINI.name, MINI.mm_per_px, MINI.mm_per_px_sigma, make="gelsight-mini")
    assert by_profile == own


def test_the_view_that_is_asked_for_goes_first_and_a_make_s_where_the_scale_is_its_own():
    own = SensorSettings("mine", 0.07, view=View((480, 640), flip="x"))
    frame = (480, 640)
    assert ReadOptions(crop=(1, 2, 30, 40)).view(own, frame) == View(frame, (1, 2, 30, 40))
    assert ReadOptions(sensor="gelsight-mini").view(own, frame) == own.view
    plain = SensorSettings("mine", 0.07)
    assert ReadOptions().view(plain, frame).is_identity
    assert ReadOptions(sensor="gelsight-mini").view(plain, frame) == MINI.view(frame)
    mini = SensorSettings("my Mini", 0.0634, make="gelsight-mini")
    assert ReadOptions().view(mini, frame) == MINI.view(frame)
    assert ReadOptions().view(replace(mini, mm_per_px=0.0317), frame).is_identity, "cut by the user"


def test_a_ball_and_a_scale_have_to_be_known(tmp_path):
    with pytest.raises(DataError, match=r"No scale for .*--mm-per-px.*gelform scale"):
        ReadOptions().settings(tmp_path)
    assert ReadOptions(ball_diameter_mm=6.35).ball("x") == 6.35
    with pytest.raises(DataError, match=r"x: which ball pressed\?.*--ball-diameter-mm"):
        ReadOptions().ball("x")


def test_large_images_are_reduced_to_what_the_blur_leaves_and_small_ones_stay():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (485, 733, 3), dtype=np.uint8)
    press = Press("a", image, 6.0, label=(100.5, 20.5, 30.0), center_px=(100.5, 20.5))
    made = presses_from_settings(
        SensorSettings("mine", 0.02, 0.001), "here", [press], image.astype(np.float32), View()
    )
    small = made.reduced()
    assert (small.image_shape, small.mm_per_px, small.reduced_by) == ((242, 366), 0.04, 2)
    means = image[:484, :732].reshape(242, 2, 366, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(small.background, means, atol=1e-3)
    assert np.abs(small.presses[0].image - means).max() <= 0.5
    assert small.presses[0].label == (50.0, 10.0, 15.0)
    assert small.presses[0].center_px == (50.0, 10.0)
    assert small.as_read(small.presses[0].label) == press.label
    assert small.from_read(press.label) == small.presses[0].label
    assert small.reduced() is small


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


def test_images_of_a_make_carry_the_view_of_its_camera(presses):
    images = replace(presses, presses=(), background=np.zeros((240, 320, 3), np.float32), mm_per_px=0.0634)
    assert images.camera_view.is_identity
    mini = replace(images, make="gelsight-mini")
    assert mini.camera_view == MINI.view((2464, 3280))
    own = View((300, 400), image_shape=(240, 320))
    assert replace(mini, view=own).camera_view == own


def test_a_pitch_and_a_gel_s_width_that_nothing_has_are_refused(presses):
    for pitch, message in (
        *((pitch, "mm_per_px > 0") for pitch in (0, -1.0, float("nan"))),
        (0.9, "a gel between 3 and 150 mm wide, got 176 px of 0.9 mm: 158 mm"),
        (0.0126, "a gel between 3 and 150 mm wide, got 176 px of 0.0126 mm: 2.22 mm"),
    ):
        with pytest.raises(ValueError, match=message):
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


HOW = {"mm_per_px": 0.1, "ball_diameter_mm": 5}


@pytest.fixture
def py3dcal(folder, simulated, tmp_path):
    """The simulated presses of the first ball as py3DCal lays them out."""
    target = tmp_path / "py3dcal"
    for name in ("annotations", "blank_images", "probe_images"):
        (target / name).mkdir(parents=True)
    shutil.copy(folder / "background.png", target / "blank_images" / "blank.png")
    first = simulated.presses[0].ball_diameter_mm
    rows = ["img_name,x_mm,y_mm,penetration_depth_mm,x_px,y_px"]
    for k, press in enumerate(simulated.presses):
        if press.ball_diameter_mm == first:
            bgr = cv2.cvtColor(press.image, cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(target / "probe_images" / f"{k}_X1Y2.png"), bgr)
            x, y = press.center_px
            rows.append(f"{k}_X1Y2.png,1.0,2.0,0.5,{x},{y}")
    (target / "annotations" / "annotations.csv").write_text("\n".join(rows) + "\n")
    facts = {"px_per_mm": 1 / simulated.sensor.mm_per_px, "probe_radius_mm": first / 2}
    (target / "annotations" / "metadata.json").write_text(json.dumps(facts))
    return target


@pytest.fixture
def pack(simulated, tmp_path):
    """The simulated presses as Taxim's dataPack.npz, as arrays to be spoiled and the path to save them at."""
    arrays = {
        "f0": simulated.background[..., ::-1],
        "imgs": np.stack([press.image[..., ::-1] for press in simulated.presses]),
        "touch_center": np.array([press.center_px for press in simulated.presses]),
        "touch_radius": np.array([round(press.contact_radius_px) for press in simulated.presses]),
        "names": np.array([f"frame_{k}.jpg" for k in range(len(simulated.presses))]),
    }
    return arrays, tmp_path / "dataPack.npz"


def test_py3dcal_folder(py3dcal, simulated):
    assert kind_of_presses(py3dcal) == "py3DCal folder"
    read = gelform.read_presses(py3dcal)
    truth = simulated.presses[::2]
    assert len(read.presses) == len(truth)
    for press, true in zip(read.presses, truth):
        np.testing.assert_array_equal(press.image, true.image)
        assert press.ball_diameter_mm == pytest.approx(true.ball_diameter_mm)
        assert press.center_px == pytest.approx(true.center_px)
        assert press.label is None  # the stage knows where, not how wide
    assert read.mm_per_px == pytest.approx(simulated.sensor.mm_per_px)
    np.testing.assert_array_equal(read.background, simulated.background)


def test_py3dcal_before_its_annotation_says_what_is_missing(py3dcal):
    (py3dcal / "annotations" / "annotations.csv").rename(py3dcal / "annotations" / "probe_data.csv")
    for moves in (False, True):
        if moves:
            shutil.move(py3dcal / "annotations" / "probe_data.csv", py3dcal / "probe_data.csv")
            shutil.rmtree(py3dcal / "annotations")
        with pytest.raises(DataError, match=r"\.csv.* is missing\. probe_data\.csv .*Run py3DCal's annotate"):
            gelform.read_presses(py3dcal)


def test_py3dcal_metadata_beside_the_folders_and_what_is_given_goes_first(py3dcal):
    shutil.move(py3dcal / "annotations" / "metadata.json", py3dcal / "metadata.json")
    read = gelform.read_presses(py3dcal, mm_per_px=0.2, ball_diameter_mm=4)
    assert (read.mm_per_px, read.presses[0].ball_diameter_mm) == (0.2, 4)


def test_spoilt_py3dcal(py3dcal):
    facts = py3dcal / "annotations" / "metadata.json"
    numbers = (0, 2), ("1" + "0" * 400, 2), (1e-4, 2), (10, 150)  # a pitch of 10 m, a ball of 300 mm
    spoilt = [f'{{"px_per_mm": {scale}, "probe_radius_mm": {radius}}}' for scale, radius in numbers]
    for text in (*spoilt, "{not json", "[" * 100_000):
        facts.write_text(text)
        with pytest.raises(DataError, match="px_per_mm and probe_radius_mm > 0"):
            gelform.read_presses(py3dcal)
    facts.unlink()
    with pytest.raises(DataError, match=r"No file .*metadata\.json"):
        gelform.read_presses(py3dcal)
    facts.write_text('{"px_per_mm": 10, "probe_radius_mm": 2}')
    (py3dcal / "annotations" / "annotations.csv").write_text("img_name,x_mm,y_mm\na.png,1,2\n")
    with pytest.raises(DataError, match="x_px, y_px missing"):
        gelform.read_presses(py3dcal)
    (py3dcal / "blank_images" / "blank.png").unlink()
    with pytest.raises(DataError, match=r"No background in .*blank_images"):
        gelform.read_presses(py3dcal)


@pytest.mark.parametrize("where", ["dataPack.npz", "."])
def test_taxim_pack_is_turned_to_rgb(pack, simulated, where):
    arrays, path = pack
    np.savez(path, **arrays)
    assert kind_of_presses(path.parent / where) == "Taxim dataPack"
    read = gelform.read_presses(path.parent / where, **HOW)
    np.testing.assert_array_equal(read.background, simulated.background)
    for k, (press, true) in enumerate(zip(read.presses, simulated.presses)):
        np.testing.assert_array_equal(press.image, true.image)
        assert press.name == f"frame_{k}.jpg"
        assert press.label == pytest.approx((*true.center_px, round(true.contact_radius_px)))


def test_what_counts_as_a_taxim_pack(pack, tmp_path):
    np.savez(tmp_path / "renamed.npz", **pack[0])
    assert kind_of_presses(tmp_path / "renamed.npz") == "Taxim dataPack"
    np.savez(tmp_path / "else.npz", depth=np.zeros(3))
    assert kind_of_presses(tmp_path / "else.npz") is None
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(DataError, match="a file of another kind"):
        gelform.read_presses(tmp_path / "text.npz")


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("unpickled",))


@pytest.mark.parametrize(
    ("changed", "how", "message"),
    [
        ({}, {"mm_per_px": 0.1}, "which ball pressed"),
        ({}, {"ball_diameter_mm": 5}, "No scale"),
        ({"imgs": np.array([Trap()], dtype=object)}, HOW, r"Python objects.*refused"),
        ({"touch_radius": np.ones(3)}, HOW, r"touch_radius \(N,\)"),
        ({"f0": None}, HOW, "f0 missing"),
    ],
)
def test_spoilt_taxim_packs_are_refused_and_never_unpickled(pack, changed, how, message):
    arrays, path = pack
    np.savez(path, **{name: one for name, one in {**arrays, **changed}.items() if one is not None})
    with pytest.raises(DataError, match=message):
        gelform.read_presses(path, **how)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(DataError, match="truncated or damaged"):
        gelform.read_presses(path, **HOW)


def test_real_taxim_pack(data):
    read = gelform.read_presses(data / "taxim-ball-lowres", mm_per_px=0.1, ball_diameter_mm=4)
    assert len(read.presses) == 49
    assert read.image_shape == (120, 160)
    assert all(press.label is not None for press in read.presses)


@pytest.mark.parametrize("name", ["f0", "imgs", "touch_center", "touch_radius"])
def test_a_member_of_a_taxim_pack_that_is_no_array_of_numbers_is_refused(pack, name):
    arrays, path = pack
    with zipfile.ZipFile(path, "w") as archive:
        for other, array in arrays.items():
            stream = io.BytesIO()
            np.save(stream, array)
            archive.writestr(*((other, b"raw") if other == name else (f"{other}.npy", stream.getvalue())))
    np.savez(texts := path.with_name("texts.npz"), **{**arrays, name: np.array(["a", "b"])})
    for spoilt in (path, texts):
        with pytest.raises(DataError, match=f"Expected {name} as an array of numbers"):
            gelform.read_presses(spoilt, **HOW)


SETTINGS = SensorSettings(
    'A "gel"',
    0.2,
    0.001,
    serial="S1",
    gel_id="G1",
    make="digit",
    gel_thickness_mm=3.5,
    view=View((48, 64), crop=(2, 2, 60, 44)),
    camera={"exposure": 50, "fourcc": "MJPG"},
)
RNG = np.random.default_rng(0)


def frame(pressed=False):
    image = 100 + RNG.normal(0, 1.5, (48, 64, 3))
    if pressed:
        image[20:28, 30:40] += 25
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture
def taken(tmp_path):
    started = TakenPresses(tmp_path / "p", SETTINGS, 6.35)
    started.take_background([frame() for _ in range(10)])
    return started


def test_calibrate_reads_what_was_taken(taken):
    presses = [frame(pressed=True) for _ in range(3)]
    for image in presses:
        taken.take_press(image)
    found = read_presses(taken.folder)
    assert [press.ball_diameter_mm for press in found.presses] == [6.35] * 3
    np.testing.assert_array_equal(found.presses[1].image, presses[1][2:46, 2:62])
    assert found.camera == SETTINGS.camera
    assert abs(found.background.mean() - 100) < 0.5


def test_a_miss_is_not_taken(taken):
    with pytest.raises(DataError, match="Nothing is pressed"):
        taken.take_press(frame())
    assert taken.count == 0
    assert list((taken.folder / "images").iterdir()) == []


def test_the_last_one_can_be_taken_out(taken):
    assert taken.drop_last() is None
    for _ in range(2):
        taken.take_press(frame(pressed=True))
    assert taken.drop_last() == "images/0001.png"
    assert len(read_presses(taken.folder).presses) == 1
    assert taken.take_press(frame(pressed=True)) == "images/0001.png"


def test_the_background_comes_first_and_a_folder_with_something_in_it_is_kept(tmp_path):
    with pytest.raises(DataError, match="background before"):
        TakenPresses(tmp_path / "p", SETTINGS, 6.0).take_press(frame(pressed=True))
    (tmp_path / "mine").write_text("x")
    with pytest.raises(DataError, match="new or empty"):
        TakenPresses(tmp_path, SETTINGS, 6.0)


def test_settings_survive_their_toml(tmp_path):
    (tmp_path / "sensor.toml").write_text(toml_of_settings(SETTINGS), encoding="utf-8")
    assert read_sensor_toml(tmp_path / "sensor.toml") == SETTINGS
