"""A small simulated sensor, its press folder and its calibration, made once for the tests of the commands."""

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.fit import calibrate
from gelform.calibration.presses.folder import read_presses
from gelform.cli import main
from gelform.exchange.exporters.press_folder import save_simulated_presses
from gelform.exchange.plots import save_picture
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_ball_presses, simulate_press
from made.files import web_file
from made.small_gel import save

SMALL = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.1268, name="small")


@pytest.fixture(scope="session")
def small():
    """The sensor behind the press folder."""
    return SMALL


@pytest.fixture(scope="session")
def press_folder(made_once):
    return made_once("small_presses", _pressed)


def _pressed(path):
    presses = simulate_ball_presses(
        SMALL, ball_diameters_mm=(6, 9), count=10, rng=np.random.default_rng(0), oversample=1
    )
    return save_simulated_presses(path, presses)


@pytest.fixture(scope="session")
def leds(tmp_path_factory):
    """Images of the gel at rest under the red, green and blue LEDs alone."""
    folder, rng = tmp_path_factory.mktemp("leds"), np.random.default_rng(4)
    for k, name in enumerate(("red", "green", "blue")):
        lit = tuple(led for led in SMALL.leds if int(np.argmax(led.color)) == k)
        save_picture(
            folder / f"{name}.png", simulate_background(replace(SMALL, leds=lit, ambient=(0, 0, 0)), rng)
        )
    return [folder / f"{name}.png" for name in ("red", "green", "blue")]


@pytest.fixture
def folder(press_folder, tmp_path):
    """A copy of the press folder, to be changed."""
    ignored = shutil.ignore_patterns("truth")
    return shutil.copytree(press_folder, tmp_path / "presses", ignore=ignored)


@pytest.fixture(scope="session")
def calibration_file(press_folder, made_once):
    return made_once("small_calibration", lambda path: _calibrated(press_folder, path.with_suffix(".npz")))


def _calibrated(folder, path):
    calibrate(read_presses(folder), color_model="polynomial").save(path)
    return path


@pytest.fixture(scope="session")
def foreign_images(made_once):
    """Four presses of another make, of the calibrated size and white balance: 0.4 mm deep, and read as over 3 mm."""
    return made_once("foreign_images", _pressed_elsewhere)


def _pressed_elsewhere(folder):
    other = replace(LAYOUTS["homemade"], shape=SMALL.shape, mm_per_px=SMALL.mm_per_px)
    rng = np.random.default_rng(6)
    folder.mkdir()
    for k, x_mm in enumerate((-1.5, -0.5, 0.5, 1.5)):
        where = {"depth_mm": 0.4, "center_mm": (x_mm, 0.5)}
        image = simulate_press(other, Ball(3.0), **where, rng=rng, oversample=1).image
        save(folder / f"{k}.png", np.minimum(image * np.array([1.0, 1.1, 1.3]), 255).astype(np.uint8))
    return folder


@pytest.fixture(autouse=True)
def _as_if_quick(request, monkeypatch):
    """However busy the machine is, stages have no lines."""
    if request.module.__name__.rpartition(".")[2] != "test_console":
        for name in ("STAGE_AFTER_S", "LINE_EVERY_S"):
            monkeypatch.setattr(f"gelform.cli.console.{name}", math.inf)


@pytest.fixture
def run(capsys):
    """Run a command; gives its exit status, standard output and standard error."""

    def command(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main([str(one) for one in arguments])
        said = capsys.readouterr()
        return stopped.value.code or 0, said.out, said.err

    return command


@pytest.fixture
def works(run):
    """Run a command that must succeed; gives its standard output and standard error."""

    def command(*arguments):
        code, out, err = run(*arguments)
        assert code == 0, (out, err)
        return out, err

    return command


@pytest.fixture
def fails(run):
    """Run a command that must fail with one line and no traceback; gives the line, of single spaces."""

    def command(*arguments, status=1):
        code, out, err = run(*arguments)
        assert code == status, (out, err)
        assert "Traceback" not in err
        if status == 1:
            assert err.count("\n") == 1, err
            assert err.startswith("gelform: error: ")
        return " ".join(err.split())

    return command


@pytest.fixture
def run_json(works):
    """Run a command that must succeed; gives its numbers."""
    return lambda *arguments: json.loads(works(*arguments, "--json")[0])


@pytest.fixture
def network(tmp_path):
    return web_file(tmp_path / "weights.bin")


@pytest.fixture
def imported(works, network, press_folder, tmp_path):
    path, rest = tmp_path / "imported.npz", press_folder / "background.png"
    how = ("--from", "gsrobotics-web", "--position", "true", "--background", rest)
    assert "results are in pixels" in works("import", network, *how, "-o", path)[1]
    return path
