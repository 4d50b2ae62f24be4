"""Output of commands: tables fit, numbers are valid JSON, quiet prints nothing."""

import ast
import csv
import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelform.cli
from gelform.calibration.library import add_calibration
from gelform.cli.console import ShownOption, figure, print_json, printable
from made.small_gel import Touch, calibration, image_of, save

# Sets the title of a terminal, colors, clears the screen in one byte of C1, turns the direction of writing, ends the line.
STEERING = "gel\x1b]0;owned\x07\x1b[31m\x9b2J\u202egnp.exe\u2066\nline"
SHOWN = r"gel\x1b]0;owned\x07\x1b[31m\x9b2J\u202egnp.exe\u2066\nline"


def test_json_is_json_whatever_is_in_it(capsys):
    content = {
        "nan": float("nan"),
        "array": np.float32(1.5),
        "list": (1, np.int64(2), float("inf")),
        "ä": None,
    }
    print_json(content)
    said = json.loads(capsys.readouterr().out)
    assert said == {"nan": None, "array": 1.5, "list": [1, 2, None], "ä": None}


def test_json_in_ascii_where_that_is_all_the_stream_takes(monkeypatch):
    narrow = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", narrow)
    print_json({"name": "Prüfling"})
    narrow.flush()
    assert json.loads(narrow.buffer.getvalue()) == {"name": "Prüfling"}


def test_codes_that_steer_a_terminal_are_written_as_text():
    assert printable(STEERING) == SHOWN
    assert printable("Prüfling 传感器 µm \u200d e\u0301") == "Prüfling 传感器 µm \u200d e\u0301"


@pytest.fixture
def steering(tmp_path, library):
    """A calibration, a press folder and an image that name a sensor so, or are named so."""
    made = replace(calibration(), sensor_name=STEERING, serial=STEERING, gel_id=STEERING)
    made.save(tmp_path / "cal.npz")
    add_calibration(made)
    save(tmp_path / "presses/a.png", image_of(Touch()))
    (tmp_path / "presses/sensor.toml").write_text(f"name = {json.dumps(STEERING)}\nmm_per_px = 0.1\n")
    save(tmp_path / "presses/background.png", image_of(None))
    with (tmp_path / "presses/presses.csv").open("w", newline="") as file:
        csv.writer(file).writerows([("image", "ball_diameter_mm"), ("a.png", 5), (STEERING, 5)])
    (tmp_path / STEERING).write_text("no picture")
    return tmp_path


@pytest.mark.parametrize(
    "command",
    [
        "info cal.npz",
        "info presses",
        "calibrate presses -o new.npz",
        "calibrations list",
        f"info {STEERING}",
        f"reconstruct {STEERING} -c cal.npz -o out",
        f"reconstruct presses/a.png --sensor {STEERING} -o out",
        f"info --{STEERING}",
        STEERING,
    ],
)
def test_names_in_files_do_not_steer_the_terminal(run, steering, monkeypatch, command):
    monkeypatch.chdir(steering)
    _, out, err = run(*command.split(" "))
    assert printable(out.replace("\n", "")) == out.replace("\n", "")
    assert printable(err.replace("\n", "")) == err.replace("\n", "")
    assert r"gel\x1b]0;owned\x07\x1b[31m\x9b2J" in (out + err).replace("\n", "").replace(r"\\x", r"\x")
    assert "\nline" not in out + err


def test_numbers_with_such_names_are_json(run_json, steering):
    listed = run_json("calibrations", "list")["calibrations"]
    assert listed[0]["serial"] == STEERING
    facts = run_json("info", steering / "cal.npz")
    assert STEERING in facts.values()


def test_json_has_its_own_escape(capsys):
    print_json({"name": STEERING})
    said = capsys.readouterr().out
    assert json.loads(said) == {"name": STEERING}
    assert printable(said.replace("\n", "")) == said.replace("\n", "")


def test_all_lines_go_through_the_one_filter():
    """`typer.echo` in another module is given text of gelform's own alone."""
    own = {("app.py", "version"), ("batch.py", "line")}
    for path in Path(gelform.cli.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in (
                "typer.echo",
                "print",
                "typer.secho",
            ):
                known = path.name == "console.py" or any(
                    path.name == name and word in ast.unparse(node) for name, word in own
                )
                assert known or not node.args, f"{path.name}: {ast.unparse(node)}"


def test_numbers_for_a_table():
    values = (1.23456, 12, None, float("nan"), "", "text")
    assert " ".join(map(figure, values)) == "1.23 12 - - - text"


def test_a_table_that_is_not_on_a_screen_breaks_no_name(capsys):
    name = "a/very/long/" * 20 + "name.png"
    record = {"path": name, "mm": 1.5}
    for columns, row in ((("file", "mm"), (name, 1.5)), ({"path": "file", "mm": "mm"}, record)):
        ShownOption().table("Title", columns, [row])
        title, heading, line, *_ = capsys.readouterr().out.splitlines()
        assert (title.strip(), heading.split(), line.split()) == ("Title", ["file", "mm"], [name, "1.5"])


def test_quiet(capsys):
    for shown in (ShownOption(quiet=True), ShownOption(as_json=True)):
        shown.table("Title", ("a",), [("b",)])
    ShownOption(quiet=True).say("text")
    ShownOption(as_json=True).say("shown")
    ShownOption().json({"not": "asked"})
    assert capsys.readouterr() == ("", "shown\n")


def test_progress_is_for_a_screen_alone(capsys, monkeypatch):
    with ShownOption().progress() as progress:
        progress(1, 2, "working")
    monkeypatch.setattr(sys, "stderr", None)
    with ShownOption().progress() as progress:
        progress(1, 2, "working")
    monkeypatch.undo()
    assert capsys.readouterr() == ("", "")


def test_progress_on_a_screen(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", screen)
    with ShownOption().progress() as progress:
        progress(1, 3, "first work")
        progress(3, 3, "first work")
        progress(1, 2, "other work")
    assert "first work" in screen.getvalue()
    assert "3/3" in screen.getvalue()
    assert "1/2" in screen.getvalue()
