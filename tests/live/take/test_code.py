"""What reproduces a view: the Python runs, the command lines name real commands."""

import shlex

import numpy as np
import pytest

from gelform.errors import GelformError
from gelform.live.take.code import TITLES, Situation, code_of


@pytest.fixture
def situation(calibration, pressed, tmp_path, monkeypatch):
    """A folder of one image as the source, and a calibration's file."""
    import gelform

    monkeypatch.chdir(tmp_path)
    (tmp_path / "frames").mkdir()
    gelform.save_picture("frames/0.png", pressed.image)
    calibration.save("mine.npz")
    return Situation("frames", "mine.npz", "mine.npz")


def run(view, situation):
    _, parts = code_of(view, situation)
    names = {}
    exec(parts[0]["text"], names)
    return names


@pytest.mark.parametrize("view", TITLES)
def test_the_python_of_every_view_runs(view, situation):
    run(view, situation)


def test_it_gives_what_the_page_shows(situation, result):
    np.testing.assert_array_equal(run("depth", situation)["depth_mm"], result.depth_mm)
    np.testing.assert_array_equal(run("normals", situation)["normals"], result.normals)
    assert np.abs(run("difference", situation)["difference_mm"]).max() == 0
    assert run("time", situation)["deepest_mm"] == result.peak_mm


def test_the_shipped_calibration_is_used_where_no_file_was_given(situation):
    _, parts = code_of("depth", Situation("simulated", None))
    assert "ready_calibration" in parts[0]["text"]
    assert parts[1]["text"] == "gelform live simulated"


@pytest.mark.parametrize("view", TITLES)
def test_command_lines_name_real_commands_and_quote(view):
    from gelform.cli import command_names

    now = Situation("my folder", "my cal.npz", "b.npz", background=True, solver="dct")
    for line in code_of(view, now)[1][1]["text"].splitlines():
        words = shlex.split(line)
        assert words[0] == "gelform"
        assert words[1] in command_names()
        assert {"my cal.npz"} <= set(words)


def test_a_background_of_the_page_is_named():
    assert "background.png" in code_of("depth", Situation("s", "c.npz", background=True))[1][0]["text"]


def test_there_is_no_code_of_another_view():
    with pytest.raises(GelformError):
        code_of("nonsense", Situation("s", None))
