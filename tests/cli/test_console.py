"""Output of commands: tables fit, numbers are valid JSON, quiet prints nothing."""

import io
import json
import sys

import numpy as np

from gelform.cli.console import figure, print_json, progress_shown, show_table
from gelform.cli.options import ShownOption


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


def test_numbers_for_a_table():
    assert [figure(v) for v in (1.23456, 12, None, float("nan"), "text")] == ["1.23", "12", "-", "-", "text"]


def test_a_table_that_is_not_on_a_screen_breaks_no_name(capsys):
    name = "a/very/long/" * 20 + "name.png"
    show_table("Title", ("file", "mm"), [(name, "1.5")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].strip() == "Title"
    assert any(name in line and "1.5" in line for line in lines)


def test_quiet(capsys):
    for shown in (ShownOption(quiet=True), ShownOption(as_json=True)):
        shown.table("Title", ("a",), [("b",)])
    ShownOption(quiet=True).say("text")
    ShownOption(as_json=True).say("shown")
    ShownOption().json({"not": "asked"})
    assert capsys.readouterr() == ("", "shown\n")


def test_progress_is_for_a_screen_alone(capsys, monkeypatch):
    with progress_shown(False) as progress:
        progress(1, 2, "working")
    monkeypatch.setattr(sys, "stderr", None)
    with progress_shown(False) as progress:
        progress(1, 2, "working")
    monkeypatch.undo()
    assert capsys.readouterr() == ("", "")


def test_progress_on_a_screen(monkeypatch):
    screen = io.StringIO()
    monkeypatch.setattr(screen, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stderr", screen)
    with progress_shown(False) as progress:
        progress(1, 3, "first work")
        progress(3, 3, "first work")
        progress(1, 2, "other work")
    assert "first work" in screen.getvalue()
    assert "3/3" in screen.getvalue()
    assert "1/2" in screen.getvalue()
