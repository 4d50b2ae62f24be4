"""A mistake of the user's is one line and status 1; a bug says that it is one, with status 70."""

import subprocess
import sys

import pytest

from gelform.cli.failures import mistakes_in
from gelform.errors import DataError

BUGS = [ValueError("NaN"), TypeError("no"), IndexError("out"), ZeroDivisionError(), RecursionError("deep")]


@pytest.fixture
def broken(monkeypatch, tmp_path):
    """`gelform info` of a file raises what it is told."""

    def breaks(problem):
        def raises(path):
            raise problem

        monkeypatch.setattr("gelform.npz_files.kind_of_npz", raises)
        (tmp_path / "file").touch()
        return tmp_path / "file"

    return breaks


@pytest.mark.parametrize("problem", BUGS, ids=lambda problem: type(problem).__name__)
def test_a_bug_says_that_it_is_one(broken, run, problem):
    code, out, err = run("info", broken(problem))
    assert (code, out) == (70, "")
    assert err.startswith(f"gelform: bug: {type(problem).__name__}: {problem}")
    assert "please report" in err
    assert "cli/commands/inspection/info.py, line" in err, "the last place in gelform itself, not in the test"
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (DataError("Expected two,\n got one."), "gelform: error: Expected two, got one.\n"),
        (PermissionError(13, "Permission denied", "x.npz"), "gelform: error: Permission denied: x.npz.\n"),
        (OSError("odd"), "gelform: error: odd\n"),
        (
            DataError("Give mm_per_px= (--mm-per-px), or allow it: overwrite=True (--overwrite)."),
            "gelform: error: Give --mm-per-px, or allow it: --overwrite.\n",  # options, not Python's parameters
        ),
        (
            MemoryError(),
            "gelform: error: not enough memory for this. Use smaller images, or fewer at a time.\n",
        ),
    ],
)
def test_a_mistake_is_one_line(broken, run, problem, said):
    assert run("info", broken(problem)) == (1, "", said)


def test_an_interrupt_is_one_line_and_130(broken, run):
    assert run("info", broken(KeyboardInterrupt())) == (130, "", "gelform: interrupted.\n")


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


def test_a_pipe_that_nobody_reads_is_no_traceback(press_folder):
    program = f"{sys.executable} -m gelform info --help | true"
    ran = subprocess.run(["bash", "-c", program], capture_output=True, text=True)
    assert "Traceback" not in ran.stderr
