"""Code that reproduces a view: the Python and the command lines run and give the page's numbers."""

import shlex
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import gelform
from gelform.errors import GelformError
from gelform.exchange.plots.canvas import save_picture
from gelform.live.code import TITLES, Situation, code_of
from gelform.live.lists import Origin
from gelform.live.player import ReplayedFrame
from gelform.live.setup import Setup
from gelform.live.shown import Shown, measures_of
from gelform.live.snapshots import FILES
from gelform.live.start import Options, start
from live_waiting import until

MINE = Origin("gelform.load_calibration('mine.npz')", (), Path("mine.npz"))
OTHER = Origin("gelform.load_calibration('other.npz')", (), Path("other.npz"))
FRAME = 1  # of two


@pytest.fixture
def situation(calibration, polynomial_calibration, press, simulated, tmp_path, monkeypatch):
    """A folder of two images as the recording, the second one shown, compared; background and zero were set."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    save_picture("frames/0.png", simulated.presses[0].image)
    save_picture("frames/1.png", press.image)
    calibration.save("mine.npz")
    polynomial_calibration.save("other.npz")
    return Situation("frames", MINE, OTHER, True, True, "multigrid", FRAME, (120, 60))


@pytest.fixture
def page(situation, calibration, polynomial_calibration, press, simulated):
    """What a station shows in that situation; a snapshot of it lies in the folder."""
    frame = ReplayedFrame(press.image, 0.0, 0, 0, None, FRAME, 0.0)
    setup = Setup(solver="multigrid").with_calibration(calibration, "mine")
    setup = setup.with_background(np.rint(simulated.background).astype(np.float32)).with_other(
        polynomial_calibration, "other"
    )
    first = setup.result_of(frame, press.image, alone=True)
    setup = replace(setup, zero_mm=(0.25 * first.depth_mm).astype(np.float32))
    result = setup.against_zero(first)
    set_here = {"background": setup.background, "zero_mm": setup.zero_mm}
    shown = Shown(1, frame, press.image, result, setup.other_of(frame), **set_here)
    for name in ("frame.png", "background.png", "zero.npy"):
        Path(name).write_bytes(FILES[name](shown))
    return shown


def run(view, situation):
    names = {}
    exec(code_of(view, situation)[1][0]["text"], names)
    return names


def test_the_python_of_every_view_gives_what_the_page_shows(page, situation):
    result = page.result
    for view in ("surface", "depth"):
        np.testing.assert_array_equal(run(view, situation)["depth_mm"], result.depth)
    np.testing.assert_array_equal(run("image", situation)["image"], page.image)
    np.testing.assert_array_equal(run("confidence", situation)["confidence"], result.confidence)
    np.testing.assert_allclose(run("sigma", situation)["sigma_mm"], result.depth_sigma_mm, rtol=1e-6)
    np.testing.assert_array_equal(run("other", situation)["other_mm"], page.other.depth)
    np.testing.assert_array_equal(
        run("difference", situation)["difference_mm"], result.depth - page.other.depth
    )
    profile = run("profile", situation)
    np.testing.assert_array_equal(profile["along_x"], result.depth[60])
    np.testing.assert_array_equal(profile["along_y"], result.depth[:, 120])


def test_numbers_normals_and_causes_too(page, situation):
    names, measures = run("time", situation), measures_of(page.result)
    found = [names[name] for name in ("deepest_mm", "area_mm2", "volume_mm3")]
    assert found == pytest.approx([measures.peak, measures.area, measures.volume], rel=1e-5)
    slopes = gelform.gradients_from_depth(page.result.depth, mm_per_px=page.result.mm_per_px)
    np.testing.assert_array_equal(
        run("normals", situation)["normals"], gelform.normals_from_gradients(slopes)
    )
    assert {"saturated", "shadow"} <= run("causes", situation)["causes"].keys()


@pytest.mark.parametrize("view", TITLES)
def test_the_python_of_every_view_runs_without_what_was_set(view, situation):
    plain = Situation("frames", MINE, OTHER, number=FRAME)
    run(view, plain)
    run("image", Situation("frames", None, number=0))


@pytest.mark.slow
@pytest.mark.parametrize("view", ["depth", "causes", "difference"])
def test_the_command_line_of_every_kind_runs(view, page, situation):
    """On the files that a snapshot leaves. Of `gelform live` the arguments are read; it would serve until it is stopped."""
    from gelform.cli.app import app

    plain = Situation("frames", MINE, OTHER, background=view != "difference", number=FRAME)
    again, files = code_of(view, plain)[1][1]["text"].splitlines()
    assert shlex.split(again) == ["gelform", "live", "frames", "-c", "mine.npz"]
    ran = CliRunner().invoke(app, shlex.split(files)[1:])
    assert ran.exit_code == 0, ran.output
    assert any(Path("out").iterdir())
    if view == "depth":
        wanted = gelform.Reconstructor(
            gelform.load_calibration("mine.npz"), background=gelform.read_image("background.png")
        )
        np.testing.assert_array_equal(
            gelform.load_result("out/frame.npz").depth_mm, wanted(page.frame).depth_mm
        )


@pytest.mark.parametrize("view", TITLES)
def test_command_lines_name_real_commands_and_quote(view):
    from gelform.cli import command_names

    mine = Origin("", (), Path("my cal.npz"))
    now = Situation("my folder", mine, OTHER, background=True, solver="dct")
    for line in code_of(view, now)[1][1]["text"].splitlines():
        words = shlex.split(line)
        assert words[0] == "gelform"
        assert words[1] in command_names()
        assert {"my cal.npz"} <= set(words)


@pytest.mark.slow
def test_the_calibration_of_a_simulated_sensor_is_named_by_its_sensor():
    with closing(start(Options(rate_hz=20))) as hub:
        name = until(lambda: hub.stations[0].setup.name, 20)
        text = code_of("depth", Situation("simulated", hub.calibrations.origin_of(name)))[1]
    assert "simulated_sensor_named('three-edges')" in text[0]["text"]
    assert text[1]["text"] == "gelform live simulated"
    exec(text[0]["text"], names := {})
    assert names["depth_mm"].shape == (240, 320)


def test_what_there_is_no_code_of_is_said():
    for view, calibration in (("nonsense", MINE), ("depth", None), ("difference", MINE)):
        with pytest.raises(GelformError):
            code_of(view, Situation("s", calibration))
