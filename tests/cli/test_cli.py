"""The commands as a whole: help that starts at once, statuses, one line for a mistake."""

import re
import subprocess
import sys

import pytest

from gelform.cli import app, main

COMMANDS = ("demo", "calibrate", "reconstruct", "evaluate", "simulate", "design", "import", "compare", "info")
HEAVY = ("numpy", "scipy", "cv2", "numba", "matplotlib")


@pytest.mark.parametrize(
    "arguments", [[], ["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)]
)
def test_help_imports_nothing_heavy(arguments):
    program = f"""
import sys
from gelform.cli import main
try:
    main({arguments!r})
finally:
    print("heavy:", *[name for name in {HEAVY!r} if name in sys.modules], file=sys.stderr)
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.stdout or not arguments, ran.stderr
    assert ran.stderr.strip().splitlines()[-1:] == ["heavy:"]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_worked_examples_that_name_real_options(run, name):
    code, out, _ = run(name, "--help")
    assert code == 0
    examples = [line.split() for line in out.splitlines() if line.strip().startswith(f"gelform {name}")]
    assert len(examples) >= 2
    offered = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", out.split("Options:")[1]))
    used = {word for line in examples for word in line if re.match(r"--?[a-z]", word)}
    assert used <= offered


def test_every_command_is_listed(run):
    listed = run("--help")[1]
    assert {command.callback.__name__.rstrip("_") for command in app.registered_commands} == set(COMMANDS)
    assert all(re.search(rf"^  {name} ", listed, re.M) for name in COMMANDS)


def test_version(run):
    from gelform import __version__

    assert run("--version")[1].strip() == f"gelform {__version__}"


def test_wrong_usage_is_status_2(run):
    for arguments in (
        ("nonsense",),
        ("calibrate",),
        ("reconstruct", "--nonsense"),
        ("simulate", "-o", "x", "--count", "0"),
    ):
        code, _, err = run(*arguments)
        assert code == 2, arguments
        assert "Traceback" not in err


def test_a_traceback_comes_when_it_is_asked_for(monkeypatch, tmp_path):
    from gelform.errors import DataError

    monkeypatch.setenv("GELFORM_DEBUG", "1")
    with pytest.raises(DataError):
        main(["info", str(tmp_path / "missing")])
