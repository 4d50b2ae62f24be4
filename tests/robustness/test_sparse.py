"""Files of a terabyte that take no room on a disk: each is named, and no memory is asked for."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import gelform
from gelform.calibration.presses.folder import read_presses
from gelform.cli import main
from gelform.errors import CalibrationError, DataError, GelformError
from gelform.exchange.importers.tables import is_taxim_forward, read_lut, read_taxim_forward
from gelform.foundations.npz_files import write_npz
from gelform.sensors.files import read_sensor_toml
from gelform.sensors.simulated.settings import read_simulated_sensor
from made.small_gel import Touch, calibration, image_of, save

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
    # An array is read from the disk where it is used: what is refused is its header.
    assert f"got {path} of 1.1e+06 MB" in said or (ending == ".npy" and "is no array file" in said)


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
