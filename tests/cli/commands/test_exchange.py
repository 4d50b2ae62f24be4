"""gelform import and gelform export.

gelform calibrations: list, add, remove, export; and the commands that search the library if no calibration is given.
"""

import io
import json
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.library import add_calibration, entries
from gelform.calibration_file import load_calibration
from gelform.cli.commands import exchange
from gelform.exchange.exporters.surface import RENDERERS, SURFACES
from gelform.result import load_result, save_result
from made.small_gel import Touch, calibration, image_of, save


@pytest.fixture
def importing(network, press_folder):
    """The beginning of a command that imports a network."""
    how = ("--from", "gsrobotics-web", "--position", "zeros", "--background", press_folder / "background.png")
    return ("import", network, *how)


def test_what_was_imported_reconstructs_in_pixels(works, run_json, imported, press_folder, tmp_path):
    """A network of random numbers gives slopes that are no surface's: it is said, and the frame is doubtful."""
    image = press_folder / "images" / "0000.png"
    how = ("-c", imported, "-o", tmp_path / "out", "--format", "npz,png", "--accept-doubtful")
    (row,) = run_json("reconstruct", image, *how)["results"]
    assert row["peak_px"] > 0
    assert "peak_mm" not in row
    with np.load(tmp_path / "out" / f"{image.stem}.npz") as file:
        assert "depth_px" in file.files
        assert "depth_mm" not in file.files
    assert run_json("info", tmp_path / "out" / f"{image.stem}.npz")["depth_px"][1] > 0
    assert run_json("info", imported)["mm_per_px"] is None
    out, err = works("reconstruct", image, "-c", imported, "-o", tmp_path / "again", "--accept-doubtful")
    assert "The slopes contradict each other" in err
    assert "peak (px)" in out
    assert str(row["contact_px"]) in out.split()
    assert "depth_px, not depth_mm" in err


def test_with_a_scale_in_mm(run_json, importing, tmp_path):
    said = run_json(*importing, "--mm-per-px", "0.1", "--name", "mine", "-o", tmp_path / "new" / "cal.npz")
    assert (said["mm_per_px"], said["sensor_name"], said["color_model"]) == (0.1, "mine", "network")
    assert gelform.load_calibration(tmp_path / "new" / "cal.npz").digest == said["digest"]


def test_an_unusual_width_of_the_gel_is_noted(works, fails, importing, tmp_path):
    err = works(*importing, "--mm-per-px", "0.025", "-o", tmp_path / "cal.npz")[1]
    assert "this one would be 160 px of 0.025 mm: 4 mm" in err
    said = fails(*importing, "--mm-per-px", "0.01", "-o", tmp_path / "b.npz")
    assert "160 px of 0.01 mm: 1.6 mm" in said


def test_the_assumed_range_of_a_table_is_said_and_another_one_is_read(works, press_folder, tmp_path):
    """A table over +-256 that is read as one over +-90 reads slopes 2.8 times too large."""
    at = (np.arange(64) + 0.5) * 8 - 256
    _, _, red = np.meshgrid(at, at, at, indexing="ij")
    np.save(tmp_path / "table.npy", np.stack([0.004 * red, 0 * red], axis=-1))
    rest = press_folder / "background.png"
    how = ("import", tmp_path / "table.npy", "--from", "lut", "--background", rest, "--mm-per-px", "0.1268")
    assumed, given = tmp_path / "assumed.npz", tmp_path / "given.npz"
    assert "so -90 to 90 gray levels are assumed" in works(*how, "-o", assumed)[1]
    assert "levels are assumed" not in works(*how, "-o", given, "--range", "-256", "256")[1]
    image = gelform.read_image(press_folder / "images" / "0000.png")
    wrong, right = (
        gelform.Reconstructor(gelform.load_calibration(path)).from_image(image) for path in (assumed, given)
    )
    steep = (abs(right.observed_gradients[..., 0]) > 0.02) & (abs(right.observed_gradients[..., 0]) < 0.1)
    ratio = np.median(wrong.observed_gradients[steep, 0] / right.observed_gradients[steep, 0])
    assert ratio == pytest.approx(256 / 90, rel=0.02)


def test_the_crop_of_a_frame_is_said(works, importing, tmp_path):
    y, x = np.mgrid[:480, :640]
    save(tmp_path / "rest.png", np.stack([200 - x / 6, y / 6 + 60, x / 6 + 60], -1).astype(np.uint8))
    how = ("--mm-per-px", "0.0634", "-o", tmp_path / "cal.npz")
    err = works(*importing[:-1], tmp_path / "rest.png", *how)[1]
    assert "Frames of 480x640 px are cropped and resized as gsrobotics-web does" in err
    assert gelform.load_calibration(tmp_path / "cal.npz").image_shape == (240, 320)


@pytest.fixture
def result_file(calibration_file, press_folder, tmp_path):
    image = gelform.read_image(press_folder / "images" / "0000.png")
    path = tmp_path / "ball.npz"
    save_result(gelform.Reconstructor(calibration_file)(image), path)
    return path


def test_what_is_offered_is_what_there_is():
    assert tuple(RENDERERS) == exchange.RENDERERS
    assert {f".{name}" for name in exchange.FILES} == set(SURFACES) - {".tif"}


@pytest.mark.slow
def test_a_calibration_for_a_renderer(run, calibration_file, tmp_path):
    assert run("export", calibration_file, "--to", "isaaclab", "-o", tmp_path / "mine")[0] == 0
    written = {path.name for path in (tmp_path / "mine").iterdir()}
    assert written == {"polycalib.npz", "bg.jpg", "real_bg.npy", "settings.txt"}


def test_a_result_as_a_surface(run, fails, result_file):
    assert run("export", result_file, "--to", "tiff")[0] == 0
    assert result_file.with_suffix(".tiff").is_file()
    assert load_result(result_file).mm_per_px
    assert "is already there" in fails("export", result_file, "--to", "tiff")
    assert run("export", result_file, "--to", "tiff", "--overwrite")[0] == 0
    assert "Expected a calibration to write for taxim" in fails("export", result_file, "--to", "taxim")


MADE = {"created_utc": "2026-01-02T03:04:05+00:00", "held_out": {"normal_free_deg": 1.25}}
OLD = replace(calibration(), serial="S1", gel_id="1", **MADE)
NEW = replace(OLD, gel_id="2", created_utc="2026-11-12T13:14:15+00:00")


@pytest.fixture
def full(library):
    for one in (OLD, NEW):
        add_calibration(one)
    return library


@pytest.fixture
def presses(tmp_path):
    """A folder of one image whose sensor.toml says the serial."""
    save(tmp_path / "presses/images/a.png", image_of(Touch()))
    (tmp_path / "presses/sensor.toml").write_text('name = "known gel"\nmm_per_px = 0.1\nserial = "S1"\n')
    return tmp_path / "presses"


def test_a_calibration_is_added_once_and_listed(works, run_json, library, tmp_path):
    """A serial that is given later keeps the digest, so recordings and results still find their calibration."""
    calibration().save(tmp_path / "mine.npz")
    add, more = ("calibrations", "add", tmp_path / "mine.npz"), ("--serial", "S7", "--gel", "g")
    assert "--serial SERIAL" in works(*add)[1]
    (added,) = run_json(*add, *more)["added"]
    assert added["new"]
    assert "Already in the library" in works(*add, *more)[1]
    listed = run_json("calibrations", "list")["calibrations"]
    first, second = sorted(listed, key=lambda one: one["serial"] or "")
    assert first["digest"] == second["digest"] == calibration().digest
    assert [second[name] for name in ("serial", "gel_id", "file")] == ["S7", "g", added["file"]]
    assert load_calibration(second["file"]).serial == "S7"


def test_the_list_has_figures_and_what_is_damaged(works, run_json, full):
    (full / "cut.npz").write_text("damaged")
    out, err = works("calibrations", "list", "--gel", "1")
    assert [word in out for word in ("S1", "2026-01-02 03:04", "1.25", OLD.digest[:10])] == [True] * 4
    assert "2026-11-12" not in out
    assert err == ""
    assert "damaged: cut.npz: " in works("calibrations", "list")[1]
    listed = run_json("calibrations", "list")["calibrations"]
    assert [one["gel_id"] for one in listed] == ["2", "1", None]
    assert listed[1]["held_out"] == {"normal_free_deg": 1.25}
    assert "truncated or damaged" in listed[2]["problem"]


def test_a_serial_that_the_file_contradicts_is_refused(fails, library, tmp_path):
    OLD.save(tmp_path / "old.npz")
    said = fails("calibrations", "add", tmp_path / "old.npz", "--serial", "S2")
    assert "is of serial 'S1', not of 'S2'" in said
    assert not library.exists()


def test_remove_asks_or_is_told(run, fails, full, monkeypatch):
    assert "2 calibrations match" in fails("calibrations", "remove", "S1", "--yes")
    for answer in ("n\n", ""):
        monkeypatch.setattr("sys.stdin", io.StringIO(answer))
        code, _, err = run("calibrations", "remove", "S1", "--gel", "1")
        assert code == 1
        assert "Delete known-gel_S1_1" in err
    monkeypatch.setattr("sys.stdin", None)
    assert "--yes" in fails("calibrations", "remove", "S1", "--gel", "1")
    assert len(entries()) == 2
    assert run("calibrations", "remove", "S1", "--gel", "1", "--yes")[0] == 0
    assert [one.gel_id for one in entries()] == ["2"]
    assert "There: known-gel_S1_2" in fails("calibrations", "remove", "S3")


def test_export_gives_the_newest_as_it_is(run, fails, full, tmp_path):
    assert run("calibrations", "export", "S1", "-o", tmp_path / "out.npz")[0] == 0
    assert (tmp_path / "out.npz").read_bytes() == entries()[0].path.read_bytes()
    assert "already there" in fails("calibrations", "export", "S1", "-o", tmp_path / "out.npz")
    again = ("calibrations", "export", "S1", "--gel", "1", "-o", tmp_path / "out.npz", "--overwrite")
    assert run(*again)[0] == 0
    assert load_calibration(tmp_path / "out.npz").digest == OLD.digest


def test_reconstruct_takes_the_newest_of_the_images_serial_and_says_so(
    run, works, fails, full, presses, tmp_path
):
    image = presses / "images/a.png"
    err = works("reconstruct", image, "-o", tmp_path / "out")[1]
    assert f"{entries()[0].path.name} (gel 2, of 2026-11-12 13:14)" in err
    assert (tmp_path / "out/a.npz").exists()
    assert run("reconstruct", image, "-o", tmp_path / "quiet", "--quiet")[2] == ""
    save(tmp_path / "elsewhere/lone/a.png", image_of(Touch()))
    said = fails("reconstruct", tmp_path / "elsewhere/lone/a.png", "-o", tmp_path / "out2")
    assert "nothing says which unit" in said
    assert "Give --calibration, make one" in said


def test_a_batch_takes_it_too_and_goes_on_with_the_same(run, works, fails, full, presses, tmp_path):
    command = ("batch", presses / "images", "-o", tmp_path / "depth", "--table", "csv")
    assert "(gel 2, of 2026-11-12 13:14)" in works(*command)[1]
    newer = replace(NEW, gel_id="3", created_utc="2026-11-20T13:14:15+00:00")
    add_calibration(newer)
    assert "(gel 2, of" in run(*command)[2]  # begun with it
    assert "(gel 3, of" in run(*command, "--overwrite")[2]
    manifest = json.loads((tmp_path / "depth/manifest.json").read_text())
    assert manifest["calibration_digest"] == newer.digest
    assert run("batch", "verify", tmp_path / "depth")[0] == run("verify", tmp_path / "depth")[0] == 0


@pytest.mark.parametrize("command", ["bag", "ros"])
def test_what_sends_to_robots_asks_the_library_too(fails, full, presses, command):
    (presses / "sensor.toml").write_text('name = "known gel"\nmm_per_px = 0.1\nserial = "S9"\n')
    where = ["-o", full / "bag"] if command == "bag" else []
    assert "none with serial S9: it has calibrations of S1" in fails(command, presses / "images", *where)


def test_the_simulated_sensor_needs_no_calibration(works, library, tmp_path):
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    how = ("-o", tmp_path / "bag", "--seconds", "0.2", "--topics", "indentation")
    own = "Calibration of the simulated sensor three-edges: gelform's own."
    assert own in works("bag", "simulated", *how)[1]


def test_a_file_is_no_library(fails, monkeypatch, tmp_path):
    (tmp_path / "cal.npz").write_text("")
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path / "cal.npz"))
    assert f"got the file {tmp_path / 'cal.npz'}. Name a folder" in fails("calibrations", "list")
