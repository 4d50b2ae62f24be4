"""Output of commands: tables fit, numbers are valid JSON, quiet prints nothing.

The command as a process: one line for a mistake, signals, streams, one writer per file.
"""

import ast
import csv
import io
import json
import os
import select
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelform.cli
from gelform.calibration.library import add_calibration
from gelform.cli.console import (
    ShownOption,
    as_process,
    figure,
    mistakes_in,
    only_writer,
    print_json,
    printable,
)
from gelform.errors import DataError
from gelform.sensors.mcap import end_missing
from made.small_gel import Touch, calibration, image_of, save

# Sets the title of a terminal, colors, clears the screen in one byte of C1, turns the direction of writing, ends the line.
STEERING = "gel\x1b]0;owned\x07\x1b[31m\x9b2J\u202egnp.exe\u2066\nline"
SHOWN = r"gel\x1b]0;owned\x07\x1b[31m\x9b2J\u202egnp.exe\u2066\nline"


def test_json_is_json_whatever_is_in_it_and_has_its_own_escape(capsys):
    numbers = {"nan": float("nan"), "array": np.float32(1.5), "list": (1, np.int64(2), float("inf"))}
    print_json({**numbers, "ä": None, "name": STEERING})
    said = capsys.readouterr().out
    wanted = {"nan": None, "array": 1.5, "list": [1, 2, None], "ä": None, "name": STEERING}
    assert json.loads(said) == wanted
    assert printable(said.replace("\n", "")) == said.replace("\n", "")


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


def test_all_lines_go_through_the_one_filter():
    """`typer.echo` in another module is given text of gelform's own alone."""
    own = {("app.py", "version"), ("reconstruct.py", "line")}
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


def test_long_work_says_where_it_is_without_a_screen(capsys, monkeypatch):
    """A line for each stage, and one each half minute; nothing of a first second."""
    work = [
        (0.2, 1, "reading"), (0.9, 1, "finding circles"), (5.0, 2, "finding circles"), (6.0, 3, "finding circles"),
        (31.0, 4, "finding circles"), (36.0, 5, "finding circles"), (40.0, 1, "fitting"), (41.0, 2, "fitting"),
    ]  # fmt: skip
    clock = iter([0.0, *(time_s for time_s, *_ in work)])
    monkeypatch.setattr("gelform.cli.console.time.monotonic", lambda: next(clock))
    with ShownOption().progress() as progress:
        for _, done, what in work:
            progress(done, 9, what)
    said = ["finding circles: 2 of 9", "finding circles: 5 of 9", "fitting: 1 of 9"]
    assert capsys.readouterr().err.splitlines() == said


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


ON_POSIX = pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals and streams")

BUGS = [ValueError("NaN"), TypeError("no"), IndexError("out"), ZeroDivisionError(), RecursionError("deep")]


@pytest.fixture
def broken(monkeypatch, tmp_path):
    """`gelform info` of a file raises what it is told."""

    def breaks(problem):
        def raises(path):
            raise problem

        monkeypatch.setattr("gelform.foundations.files.kind_of_npz", raises)
        (tmp_path / "file").touch()
        return tmp_path / "file"

    return breaks


@ON_POSIX
def test_a_bug_says_that_it_is_one(broken, run):
    for problem in BUGS:
        code, out, err = run("info", broken(problem))
        assert (code, out) == (70, "")
        assert err.startswith(f"gelform: bug: {type(problem).__name__}: {problem}")
        assert "Please report" in err
        assert "cli/commands/info.py, line" in err, "the last place in gelform itself, not in the test"
        assert err.count("\n") == 1


def test_a_mistake_and_an_interrupt_are_one_line(broken, run):
    no_memory = "gelform: error: not enough memory for this. Use smaller images, or fewer at a time.\n"
    parameters = "Give mm_per_px= (--mm-per-px), or allow it: overwrite=True (--overwrite)."
    for problem, said in (
        (DataError("Expected two,\n got one."), "gelform: error: Expected two, got one.\n"),
        (PermissionError(13, "Permission denied", "x.npz"), "gelform: error: Permission denied: x.npz.\n"),
        (OSError("odd"), "gelform: error: odd\n"),
        (DataError(parameters), "gelform: error: Give --mm-per-px, or allow it: --overwrite.\n"),
        (MemoryError(), no_memory),
    ):
        assert run("info", broken(problem)) == (1, "", said)
    assert run("info", broken(KeyboardInterrupt())) == (130, "", "gelform: interrupted.\n")


@ON_POSIX
def test_a_name_that_no_file_can_have_is_a_mistake_in_every_command(fails, tmp_path):
    long, there = "a" * 5000, ("-c", tmp_path / "cal.npz")
    for command in (
        ("info", long), ("verify", long), ("evaluate", long, *there), ("explain", long, *there),
        ("batch", long, *there, "-o", tmp_path / "out"), ("bag", long, *there, "-o", tmp_path / "bag"),
        ("calibrate", long, "-o", tmp_path / "new.npz"), ("reconstruct", long, *there, "-o", tmp_path / "out"),
        ("starter", "gelsight-mini", "--background", long, "-o", tmp_path / "new.npz"),
    ):  # fmt: skip
        fails(*command)


def test_the_traceback_comes_when_it_is_asked_for(broken, run, monkeypatch):
    path = broken(IndexError("out"))
    assert "Traceback" not in run("info", path)[2]
    for arguments in (("--debug", "info", path), ("info", path)):
        code, _, err = run(*arguments)
        assert code == 70
        assert "Traceback" in err
        assert "IndexError: out" in err
        monkeypatch.setenv("GELFORM_DEBUG", "1")


def test_only_what_was_given_is_turned_round():
    with pytest.raises(DataError, match=r"a\.png: too small") as raised, mistakes_in("a.png"):
        raise ValueError("too small")
    assert isinstance(raised.value.__cause__, ValueError)
    with pytest.raises(IndexError), mistakes_in("a.png"):
        raise IndexError


GELFORM = f"{sys.executable} -m gelform"


def shell(command, **how):
    return subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=240, **how)


@ON_POSIX
@pytest.mark.slow
def test_closed_streams_are_no_traceback(calibration_file, tmp_path):
    given = (f"{calibration_file} 2>&-", f"{calibration_file} >&-", f"{tmp_path}/nothing <&- >&- 2>&-")
    for command in given:
        ran = shell(f"{GELFORM} info {command}")
        assert ran.returncode == ("nothing" in command), command
        assert "Traceback" not in ran.stderr


@ON_POSIX
@pytest.mark.slow
def test_a_reader_that_stops_is_no_traceback(press_folder):
    """Standard error belongs to the command alone: the shell's own would hide what Python says as it exits."""
    for command in ("calibrate --help", f"info {press_folder}"):
        ran = shell(f"set -o pipefail; {GELFORM} {command} | true")
        assert ran.stderr == "", command


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full")
def test_a_full_disk_behind_the_output_is_said():
    ran = shell(f"{GELFORM} --version > /dev/full")
    assert ran.returncode == 1
    assert "No space left" in ran.stderr
    assert "Traceback" not in ran.stderr


@ON_POSIX
@pytest.mark.slow
def test_streams_that_know_ascii_alone(press_folder, calibration_file, tmp_path):
    image = tmp_path / "Prüfling µ.png"
    image.write_bytes((press_folder / "images" / "0000.png").read_bytes())
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"}
    command = [*GELFORM.split(), "reconstruct", image, "-c", calibration_file, "-o", tmp_path / "o"]
    ran = subprocess.run(command, capture_output=True, env=ascii_only, timeout=240)
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert rb"Pr\xfcfling" in ran.stdout
    command += ["--overwrite", "--json"]
    again = subprocess.run(command, capture_output=True, env=ascii_only, timeout=240)
    assert json.loads(again.stdout)["results"][0]["image"] == str(image)


@ON_POSIX
def test_a_pipe_is_no_file(tmp_path, fails, calibration_file):
    pipe, to = tmp_path / "pipe.png", ("-o", tmp_path / "o")
    os.mkfifo(pipe)
    assert "got a pipe" in fails("info", pipe)
    assert "got a pipe" in fails("reconstruct", pipe, "-c", calibration_file, *to)
    assert "No file" in fails("reconstruct", tmp_path / "x.png", "-c", pipe, *to)


@ON_POSIX
@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "workers"), [(signal.SIGINT, 1), (signal.SIGINT, 2), (signal.SIGTERM, 2), (signal.SIGHUP, 2)]
)
def test_an_interrupt_is_one_line_and_leaves_nothing(kind, workers, tmp_path):
    command = f"{GELFORM} simulate -o {tmp_path}/out --count 4000 --workers {workers} --sensor digit".split()
    ran = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob(".out.partial-*/images/*.png")):
        assert time.monotonic() < deadline
        assert ran.poll() is None, ran.stderr.read()
        time.sleep(0.05)
    (os.killpg if kind == signal.SIGINT else os.kill)(ran.pid, kind)
    _, said = ran.communicate(timeout=240)
    assert (ran.returncode, said) == (130, "gelform: interrupted.\n")
    assert list(tmp_path.iterdir()) == []


# A signal as a module is imported: the command line, a library under it, and what the command itself needs.
INTERRUPTED = """
import os, signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
sys.argv = ["gelform", "reconstruct", "a.png", "-c", "c.npz", "-o", "o"]
from gelform.__main__ import run
run()
"""


@ON_POSIX
@pytest.mark.parametrize("module", ["gelform.cli", "numpy", "gelform.cli.app", "gelform.reconstruct"])
def test_an_interrupt_while_modules_are_imported_is_one_line(module, tmp_path):
    command = [sys.executable, "-c", INTERRUPTED.format(module=module)]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=240)
    assert (ran.returncode, ran.stdout, ran.stderr) == (130, "", "gelform: interrupted.\n")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no terminals here")
def test_a_terminal_that_closes_ends_a_recording_with_its_index(tmp_path):
    """As an ssh session that is cut: the terminal is gone, and SIGHUP comes from the system, and again from the shell."""
    pytest.importorskip("mcap")
    path, (here, there) = tmp_path / "a.mcap", os.openpty()
    command = [*GELFORM.split(), "record", "simulated", "-o", str(path)]
    ran = subprocess.Popen(command, stdin=there, stdout=there, stderr=there, start_new_session=True)
    os.close(there)
    try:
        deadline, rows = time.monotonic() + 240, b""
        while not path.exists() or path.stat().st_size < 200_000:
            assert time.monotonic() < deadline
            assert ran.poll() is None
            if select.select([here], [], [], 0.05)[0]:  # a terminal that nobody reads stops the program
                rows += os.read(here, 4096)
        os.close(here)
        # One bar, whatever the number of frames; it says "reconnecting" beside busy neighbors.
        assert 0 < rows.count(b"/?") <= rows.count(b"\r") + 1
        for _ in range(3):
            os.kill(ran.pid, signal.SIGHUP)
        assert ran.wait(240) in (0, 1, 130)
    finally:
        ran.kill()  # does nothing to one that has ended
        ran.wait()
    assert end_missing(path) == ""


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no SIGHUP here")
def test_nohup_stays_so_and_handlers_come_back():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with as_process():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        with pytest.raises(KeyboardInterrupt), as_process():
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_the_second_writer_of_one_file_is_refused(tmp_path, fails, press_folder):
    with only_writer(tmp_path / "cal.npz"):
        assert "Another gelform is making" in fails("calibrate", press_folder, "-o", tmp_path / "cal.npz")
        with only_writer(tmp_path / "other.npz"):
            pass
    with only_writer(tmp_path / "cal.npz"):
        pass
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DataError, match="Cannot write into"), only_writer(tmp_path / "no" / "cal.npz"):
        pass
