"""Folders of presses: three layouts give the same presses, and what is wrong with one is said."""

import csv
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.folder import rows_by_folder, with_scale, with_view
from gelform.errors import DataError
from gelform.image.view import Lens, View, image_px_from_frame_px
from gelform.result.metrics import press_errors
from gelform.sensors.profiles import SENSORS
from gelform.simulate import LAYOUTS, Optics, exposed, simulate_ball_presses
from made.images import frame_from_image


@pytest.fixture
def copy(folder, tmp_path):
    """The press folder, free to be spoiled."""
    return shutil.copytree(folder, tmp_path / "presses")


def rewrite(folder, change):
    """presses.csv with its rows changed: `change` gets the header and the rows."""
    header, *rows = csv.reader((folder / "presses.csv").read_text().splitlines())
    header, rows = change(header, rows)
    with (folder / "presses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def gs_sdk(folder, background, presses):
    """The presses as gs_sdk lays them out."""
    rows = ["experiment_reldir,diameter(mm)"]
    for k, press in enumerate(presses):
        (folder / f"5mm/{k}").mkdir(parents=True)
        cv2.imwrite(str(folder / f"5mm/{k}/gelsight.png"), press.image[..., ::-1])
        rows.append(f"5mm/{k},{press.ball_diameter_mm}")
    cv2.imwrite(str(folder / "background.png"), background[..., ::-1])
    (folder / "catalog.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_press_folder_is_read_as_it_was_written(presses, simulated):
    assert len(presses.presses) == len(simulated.presses)
    for press, truth in zip(presses.presses, simulated.presses):
        np.testing.assert_array_equal(press.image, truth.image)
        assert press.ball_diameter_mm == truth.ball_diameter_mm
        assert press.label is None
    assert presses.mm_per_px == simulated.sensor.mm_per_px
    assert presses.background.dtype == np.float32
    assert len({press.digest for press in presses.presses}) == len(presses.presses)


def test_presses_in_one_file_are_read_as_their_images(copy, presses, tmp_path):
    np.save(tmp_path / "stack.npy", [press.image for press in presses.presses])
    shutil.copy(copy / "background.png", tmp_path)
    how = {"mm_per_px": presses.mm_per_px, "ball_diameter_mm": 4}
    read = gelform.read_presses(tmp_path / "stack.npy", **how)
    assert [press.digest for press in read.presses] == [press.digest for press in presses.presses]
    np.testing.assert_array_equal(read.background, presses.background)
    with pytest.raises(DataError, match=r"has images but no presses\.csv"):
        gelform.read_presses(tmp_path / "stack.npy", mm_per_px=presses.mm_per_px)


def test_gs_sdk_folder_is_read_as_it_is(presses, tmp_path):
    target = gs_sdk(tmp_path, presses.background, presses.presses)
    np.savez(target / "5mm/0/label.npz", center=np.array([80.5, 60.0]), radius=21)
    read = gelform.read_presses(target, mm_per_px=presses.mm_per_px)
    assert [p.digest for p in read.presses] == [p.digest for p in presses.presses]
    assert read.presses[0].label == (80.5, 60.0, 21.0)
    assert read.presses[1].label is None
    for label, message in (
        ({"center": np.zeros(2)}, "radius missing"),
        ({"center": np.zeros(3), "radius": 21}, r"center \(x, y\) and radius as numbers"),
        ({"center": np.zeros(1), "radius": np.ones(2)}, r"center \(x, y\) and radius as numbers"),
        ({"center": np.array([1, np.nan]), "radius": 21}, r"center \(x, y\) and radius as numbers"),
    ):
        np.savez(target / "5mm/0/label.npz", **label)
        with pytest.raises(DataError, match=message):
            gelform.read_presses(target, mm_per_px=presses.mm_per_px)


def test_plain_folder_needs_a_ball_and_a_scale(copy, presses):
    plain = copy.parent / "plain"
    plain.mkdir()
    with pytest.raises(DataError, match=r"No scale|No background"):
        gelform.read_presses(plain)
    shutil.copy(copy / "background.png", plain)
    shutil.copy(copy / presses.presses[0].name, plain / "a.png")
    for known, message in (
        ({"ball_diameter_mm": 5.0}, "No scale"),
        ({"mm_per_px": 0.1}, "which ball pressed"),
    ):
        with pytest.raises(DataError, match=message):
            gelform.read_presses(plain, **known)
    for ball in (float("nan"), 300.0, 0.0, True, "6"):
        with pytest.raises((ValueError, TypeError), match="ball_diameter_mm"):
            gelform.read_presses(plain, mm_per_px=0.1, ball_diameter_mm=ball)
    read = gelform.read_presses(plain, ball_diameter_mm=5.0, mm_per_px=0.1)
    assert [p.name for p in read.presses] == ["a.png"]
    np.testing.assert_array_equal(read.presses[0].image, presses.presses[0].image)


@pytest.mark.slow
def test_a_folder_of_a_make_s_images_calibrates_its_camera(tmp_path):
    """gs_sdk's folder holds 240x320 px; the camera gives 2464x3280, of which the make knows the way to them."""
    mini = SENSORS["gelsight-mini"]
    made = simulate_ball_presses(
        mini.simulated(), ball_diameters_mm=[5.0, 8.0], count=9, rng=np.random.default_rng(2), oversample=1
    )
    gs_sdk(tmp_path, made.background, made.presses[:-1])
    (tmp_path / "sensor.toml").write_text('name = "mine"\nmm_per_px = 0.0634\nmake = "gelsight-mini"\n')
    calibration = gelform.calibrate(tmp_path, color_model="polynomial", start=None)
    assert calibration.view == mini.profile.view(mini.camera.frame_shape)
    assert calibration.image_shape == (240, 320)
    reconstruct, image = gelform.Reconstructor(calibration), made.presses[-1].image
    by_image, by_frame = reconstruct(image), reconstruct(frame_from_image(image, calibration.view))
    assert np.abs(by_image.depth_mm - by_frame.depth_mm).max() < 0.02
    assert by_image.peak_mm > 0.2
    with pytest.raises(ValueError, match=r"2464x3280 px .*got 480x640"):
        reconstruct(np.zeros((480, 640, 3), np.uint8))


@pytest.fixture
def wide(copy):
    """The same folder from a camera whose pixels are 1.25 times as high as wide."""
    for path in [copy / "background.png", *(copy / "images").iterdir()]:
        image = cv2.imread(str(path))
        cv2.imwrite(str(path), cv2.resize(image, (220, 132), interpolation=cv2.INTER_CUBIC))
    return copy


def settle(folder, mm_per_px):
    (folder / "sensor.toml").write_text(f'name = "simulated"\nmm_per_px = {mm_per_px}\n')
    return gelform.read_presses(folder)


def test_pixels_that_are_not_square_become_square(wide, presses):
    pitch = presses.mm_per_px
    read = settle(wide, [pitch / 1.25, pitch])
    assert read.mm_per_px == pytest.approx(pitch)
    assert read.image_shape == presses.image_shape
    assert np.abs(read.background - presses.background).mean() < 1
    given = gelform.read_presses(wide, mm_per_px=(pitch / 1.25, pitch), crop=(20, 10, 150, 110))
    assert given.image_shape == (110, 120)


@pytest.mark.slow
def test_a_calibration_in_pixels_that_are_not_square_is_that_in_square_ones(
    wide, presses, calibration, press
):
    """Frames as the camera gives them: depth and slopes are those of square pixels, and of the truth."""
    pitch = presses.mm_per_px
    made = gelform.calibrate(settle(wide, [pitch / 1.25, pitch]))
    assert made.mm_per_px == pytest.approx(pitch)
    frame = cv2.resize(press.image, (220, 132), interpolation=cv2.INTER_CUBIC)
    found, square = gelform.Reconstructor(made)(frame), gelform.Reconstructor(calibration)(press.image)
    for result in (found, square):
        assert np.sqrt(np.mean((result.depth_mm - press.depth_mm)[press.contact] ** 2)) < 0.02
        wrong = np.abs(result.gradients - press.gradients)[press.contact]
        assert np.median(wrong) < 0.04
    assert np.sqrt(np.mean((found.depth_mm - square.depth_mm)[press.contact] ** 2)) < 0.012
    untold = gelform.calibrate(settle(wide, pitch), color_model="lambertian")
    (note,) = [note for note in untold.report.notes if "not square" in note]
    assert "times wider than high" in note
    assert "mm_per_px = [x, y]" in note
    assert not [note for note in made.report.notes if "not square" in note]


@pytest.mark.parametrize("crop", [(150, 100, 60, 60), (-1, 0, 50, 50), (0, 0, 1, 1), (0, 0, 100, 23)])
def test_a_crop_beyond_the_frame_or_without_room_is_refused(copy, crop):
    with pytest.raises(DataError, match=r"[cC]rop"):
        gelform.read_presses(copy, crop=crop)


def test_crop_and_view_of_the_settings(copy):
    cropped = gelform.read_presses(copy, crop=(10, 20, 100, 80))
    assert cropped.image_shape == (80, 100)
    whole = gelform.read_presses(copy)
    np.testing.assert_array_equal(cropped.background, whole.background[20:100, 10:110])
    (copy / "sensor.toml").write_text(
        'name = "s"\nmm_per_px = 0.1\nresponse = 2.2\n[view]\nframe_shape = [132, 176]\nflip = "x"\n'
    )
    turned = gelform.read_presses(copy)
    assert turned.view == View((132, 176), flip="x")
    assert turned.response == 2.2
    np.testing.assert_allclose(turned.background, whole.background[:, ::-1])


def test_a_view_of_other_frames_and_a_name_that_no_file_has_are_named(copy):
    (copy / "sensor.toml").write_text('name = "s"\nmm_per_px = 0.1\n[view]\nframe_shape = [1, 1]\n')
    with pytest.raises(DataError, match=r"is of frames of 1x1 px, and its background is 132x176 px"):
        gelform.read_presses(copy)
    (copy / "sensor.toml").write_text('name = "s"\nmm_per_px = 0.1\n')
    (copy / "presses.csv").write_bytes(b"image,ball_diameter_mm\nimages/a\0.png,5\n")
    with pytest.raises(DataError, match="which no file can be called"):
        gelform.read_presses(copy)


def test_labels_are_read_and_rows_of_other_indenters_are_named(copy):
    """Nothing is left out silently: Flat is not flat."""

    def labeled(header, rows):
        names = ["center_x_px", "center_y_px", "contact_radius_px", "indenter", "height_mm"]
        kinds = ["ball", "Flat", *["cube"] * (len(rows) - 2)]
        label = ["80.5", "60", "21"]
        return [*header, *names], [
            [*row, *(label if kind == "ball" else [""] * 3), kind, "0.2"] for row, kind in zip(rows, kinds)
        ]

    rewrite(copy, labeled)
    read = gelform.read_presses(copy)
    assert [press.label for press in read.presses] == [(80.5, 60.0, 21.0)]
    assert ["indenter Flat: 1 (" in note for note in read.notes] == [True, False]
    assert ["indenter cube: 12 (" in note for note in read.notes] == [False, True]


def flat_rows(header, rows, *heights):
    """The first presses listed as those of a flat punch of some heights."""
    flat = [[row[0], "", "flat", height] for row, height in zip(rows, heights)]
    return [*header, "indenter", "height_mm"], flat + [[*row, "", ""] for row in rows[len(heights) :]]


def test_flat_punches_of_known_height_are_read_beside_the_balls(copy):
    whole = gelform.read_presses(copy)
    rewrite(copy, lambda header, rows: flat_rows(header, rows, "0.2", "", "0.35"))
    calls = []
    read = gelform.read_presses(copy, progress=lambda *call: calls.append(call))
    assert [(flat.name, flat.height_mm) for flat in read.flats] == [
        (whole.presses[0].name, 0.2),
        (whole.presses[2].name, 0.35),
    ]
    assert read.flats[1].digest == whole.presses[2].digest
    assert [press.name for press in read.presses] == [press.name for press in whole.presses[3:]]
    (note,) = read.notes
    assert "left out rows of presses.csv with the indenter flat without height_mm: 1 (" in note
    assert calls[-1][:2] == (13, 13)
    assert whole.flats == ()
    assert whole.notes == ()


SPOILT = {
    "missing column": (lambda h, r: (["image", "diameter"], r), "columns image, ball_diameter_mm .* missing"),
    "diameter of 0": (lambda h, r: (h, [[r[0][0], "0"], *r[1:]]), r"ball_diameter_mm > 0, got 0.* line 2"),
    "diameter in words": (lambda h, r: (h, [[r[0][0], "small"], *r[1:]]), "as a number, got 'small'"),
    "diameter of nan": (lambda h, r: (h, [[r[0][0], "nan"], *r[1:]]), "finite number"),
    "infinite diameter": (lambda h, r: (h, [[r[0][0], "1e999"], *r[1:]]), "finite number"),
    "negative diameter": (lambda h, r: (h, [[r[0][0], "-5"], *r[1:]]), "> 0"),
    "diameter in um": (lambda h, r: (h, [[r[0][0], "6350"], *r[1:]]), r"up to 200 mm, got 6350.* line 2"),
    "missing image": (lambda h, r: (h, [["nowhere.png", "5"], *r[1:]]), r"No file .*nowhere\.png"),
    "no rows": (lambda h, r: (h, []), "No press of a ball in"),
    "punches alone": (lambda h, r: flat_rows(h, r[:1], "0.5"), "beside 1 of flat punches"),
    "punches of no height": (lambda h, r: flat_rows(h, r[:1], ""), "flat without height_mm: 1 "),
    "height in um": (lambda h, r: flat_rows(h, r, "35"), "0.01 to 20 mm, got 35. Is it in mm"),
    "height in words": (lambda h, r: flat_rows(h, r, "low"), "height_mm as a number, got 'low'"),
    "negative height": (lambda h, r: flat_rows(h, r, "-0.1"), "got -0.1"),
}


def test_a_table_as_a_spreadsheet_on_windows_writes_it(copy):
    """With semicolons, decimal commas and backslashes; the values are those of the table with commas."""
    (copy / "presses.csv").write_text("image,ball_diameter_mm\nimages/0000.png,6.35\nimages/0001.png,9\n")
    own = gelform.read_presses(copy)
    table = "\ufeffimage;ball_diameter_mm;center_x_px\r\nimages\\0000.png;6,35;\r\nimages\\0001.png;9;\r\n"
    (copy / "presses.csv").write_text(table, newline="")
    read = gelform.read_presses(copy)
    assert [one.name for one in read.presses] == ["images/0000.png", "images/0001.png"]
    assert [one.ball_diameter_mm for one in read.presses] == [6.35, 9.0]
    assert [one.digest for one in read.presses] == [one.digest for one in own.presses]
    (copy / "images" / "0000.png").rename(copy / "images\\0000.png")
    names = [one.name for one in gelform.read_presses(copy).presses]
    assert names == ["images\\0000.png", "images/0001.png"], "a name where such a file is"


@pytest.mark.parametrize("name", SPOILT)
def test_spoilt_table(copy, name):
    change, message = SPOILT[name]
    rewrite(copy, change)
    with pytest.raises(DataError, match=message):
        gelform.read_presses(copy)


def test_the_folder_above_names_the_one_with_the_presses(copy, tmp_path):
    shutil.copytree(copy, tmp_path / "demo" / "presses")
    with pytest.raises(DataError, match=r"which holds others: .*demo.presses"):
        gelform.read_presses(tmp_path / "demo")


def test_no_folder_no_background_no_whole_image_and_no_such_sensor(copy, presses, tmp_path):
    with pytest.raises(gelform.SensorError, match="gelsight-mini, digit"):
        gelform.read_presses(copy, sensor="gelsite")
    path = copy / presses.presses[2].name
    path.write_bytes(path.read_bytes()[:500])
    bare = shutil.copytree(copy, tmp_path / "bare", ignore=lambda *_: ["background.png"])
    for place, message in (
        (copy, "truncated"),
        (tmp_path / "nothing", "not there"),
        (copy / "presses.csv", "which is one table: give the folder of all"),
        (copy / "background.png", "which is one picture: give the folder of all"),
        (bare, "No background"),
    ):
        with pytest.raises(DataError, match=message):
            gelform.calibrate(place)


@pytest.mark.parametrize(
    ("odd", "message"),
    [
        (["images/0003.png"], r"one size: images/0003\.png is 50x60 px; .* 13 presses"),
        (["background.png"], "the background is 50x60 px, 14 of 14 presses are 132x176 px"),
        ([f"images/000{k}.png" for k in range(6)], "and 1 more; the background and 8 presses"),
    ],
)
def test_images_of_other_sizes_are_named_and_counted(copy, odd, message):
    for name in odd:
        assert (copy / name).exists()
        cv2.imwrite(str(copy / name), np.zeros((50, 60, 3), np.uint8))
    with pytest.raises(DataError, match=message):
        gelform.read_presses(copy)


def test_a_scale_that_cannot_be_is_refused(folder):
    for pitch in (0, -0.1, float("nan"), True, "0.1", 1e300):
        with pytest.raises((ValueError, TypeError), match="mm_per_px"):
            gelform.read_presses(folder, mm_per_px=pitch)
    with pytest.raises(ValueError, match=r"give 1/15\.8 = 0\.06329"):
        gelform.read_presses(folder, mm_per_px=15.8)


GAMMA = 2.2


def presses_of(sensor, tmp_path, count=10):
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=count, rng=np.random.default_rng(6), oversample=1
    )
    gelform.save_simulated_presses(tmp_path / "presses", made)
    return made, gelform.read_presses(tmp_path / "presses")


@pytest.mark.slow
def test_a_known_response_is_undone(tmp_path):
    """Far lights, a camera of gamma 2.2: told, `lambertian` sees linear light; not told, it finds that out."""
    far = replace(LAYOUTS["ring-120"], shape=(120, 160), mm_per_px=0.1268)
    coded = exposed(replace(far, optics=Optics(response_gamma=GAMMA)), 110)
    _, presses = presses_of(coded, tmp_path)
    known = replace(presses, response=1 / GAMMA)
    plain, linear = (gelform.calibrate(one, color_model="lambertian") for one in (presses, known))
    assert linear.change.response == pytest.approx(1 / GAMMA)
    assert linear.color_model.response == pytest.approx(1, abs=0.15)
    assert plain.color_model.response == pytest.approx(1 / GAMMA, abs=0.2)
    assert linear.held_out["normal_free_deg"] < 1.2 * plain.held_out["normal_free_deg"] < 3.5
    assert any("removes the camera's response" in note for note in linear.report.notes)
    linear.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    assert again.change == linear.change
    image = presses.presses[0].image
    np.testing.assert_array_equal(
        gelform.Reconstructor(again)(image).depth_mm, gelform.Reconstructor(linear)(image).depth_mm
    )


@pytest.fixture
def bent(sensor, tmp_path):
    """Presses seen through a barrel of 12 % in the corners, as simulated, as read, and with the lens undone."""
    height, width = sensor.shape
    half = np.hypot(height, width) / 2  # unit of the simulator's distortion
    optics = Optics(distortion=(-0.12, 0.0))
    lens = Lens((half, half, (width - 1) / 2, (height - 1) / 2), optics.distortion)
    made, presses = presses_of(replace(sensor, optics=optics), tmp_path, count=9)
    return made, presses, with_view(presses, View(sensor.shape, lens=lens), "a known lens")


@pytest.mark.slow
def test_undoing_the_lens_is_better(sensor, bent):
    """Without the lens, places and slopes are off; with it the errors fall."""
    made, presses, straight = bent
    degrees = []
    for one, said in ((straight, "a known lens"), (presses, "")):
        calibration = gelform.calibrate(one, color_model="polynomial")
        reconstruct = gelform.Reconstructor(calibration)
        assert calibration.settings.get("lens", "") == said
        errors = []
        for press in made.presses:
            (center,) = image_px_from_frame_px([press.center_px], calibration.view)
            result = reconstruct(press.image)
            errors.append(
                press_errors(
                    result.depth_mm,
                    result.gradients,
                    circle_px=(*center, press.contact_radius_px),
                    ball_radius_mm=press.ball_diameter_mm / 2,
                    mm_per_px=sensor.mm_per_px,
                )
            )
        degrees.append(np.mean([error.normal_deg for error in errors]))
    assert degrees[0] < 0.9 * degrees[1]


def test_labels_move_with_their_pixels(sensor, bent):
    made, presses, straight = bent
    for press, truth in zip(straight.presses, made.presses):
        x = truth.center_mm[0] / sensor.mm_per_px + (sensor.shape[1] - 1) / 2
        y = truth.center_mm[1] / sensor.mm_per_px + (sensor.shape[0] - 1) / 2
        assert press.label[:2] == pytest.approx((x, y), abs=0.05)
        assert press.digest not in {one.digest for one in presses.presses}
    twice = with_view(presses, View(sensor.shape, image_shape=(264, 352)), "a size")
    assert [press.label[2] for press in twice.presses] == pytest.approx(
        [2 * p.label[2] for p in presses.presses]
    )


def test_a_scale_is_of_presses_or_of_those_at_a_path(folder, presses):
    scale = Scale(0.11, 0.001, "two points")
    for some in (presses, str(folder)):
        seen = with_scale(some, scale)
        assert (seen.mm_per_px, seen.mm_per_px_sigma) == (0.11, 0.001)
        assert seen.geometry.scale_source == "two points"
    for nothing in (None, [1], 3):
        with pytest.raises(TypeError, match="Expected presses"):
            with_scale(nothing, scale)


def test_folders_that_are_named_by_diameters_get_their_lines(copy, presses, tmp_path):
    target = tmp_path / "mine"
    for k, press in enumerate(presses.presses[:4]):
        folder = target / ("ball 6.35mm" if k % 2 else "4,5 mm_ball")
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copy(copy / press.name, folder / f"{k}.png")
    shutil.copy(copy / "background.png", target / "4,5 mm_ball" / "ref.png")
    (target / "0.05mm_steps.txt").write_text("no folder")
    lines = [
        "image,ball_diameter_mm",
        *(f"4,5 mm_ball/{k}.png,4.5" for k in (0, 2)),
        *(f"ball 6.35mm/{k}.png,6.35" for k in (1, 3)),
    ]
    with pytest.raises(DataError, match=r"names are diameters.*ball 6\.35mm/1\.png,6\.35.*prints all 5"):
        gelform.read_presses(target, mm_per_px=0.1, ball_diameter_mm=5)
    assert rows_by_folder(target) == lines
    assert rows_by_folder(copy) == []


def test_an_option_that_contradicts_a_table_s_ball_is_refused(copy):
    """It was left out without a word, so a corrected diameter changed nothing."""
    table = copy / "presses.csv"
    name = gelform.read_presses(copy).presses[0].name
    table.write_text(f"image,ball_diameter_mm\n{name},5\n", encoding="utf-8")
    assert gelform.read_presses(copy, ball_diameter_mm=5).presses[0].ball_diameter_mm == 5
    with pytest.raises(DataError, match=r"is 10, but .*presses\.csv, line 2, states 5"):
        gelform.read_presses(copy, ball_diameter_mm=10)


def test_a_file_of_another_case_or_suffix_is_named(copy):
    table = copy / "presses.csv"
    first = table.read_text(encoding="utf-8").splitlines()[1].split(",")[0]
    file = Path(first)
    for wrong in (file.with_name(file.name.upper()), file.with_suffix(""), file.with_suffix(".jpg")):
        table.write_text(f"image,ball_diameter_mm\n{wrong.as_posix()},4\n", encoding="utf-8")
        with pytest.raises(DataError, match=f"Did you mean {file.name}"):
            gelform.read_presses(copy)
