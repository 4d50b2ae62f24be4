"""All commands: help starts at once, exit statuses, one line for a mistake."""

import re
import subprocess
import sys

import pytest

from gelform import __version__
from gelform.cli import command_names
from gelform.cli.app import GROUPS
from gelform.cli.app import SUBCOMMANDS as WITH_OWN

COMMANDS = command_names()
BELOW = {"calibrations": ("list", "add", "remove", "export"), "force": ("calibrate", "evaluate")}
SUBCOMMANDS = (*(f"{group} {name}" for group, names in BELOW.items() for name in names), "batch verify")
HEAVY = ("numpy", "scipy", "cv2", "matplotlib", "rich")


def test_help_imports_nothing_heavy():
    """One process says after each command's help what it has brought in."""
    asked = [
        [],
        ["--help"],
        ["--version"],
        *([*name.split(), "--help"] for name in (*COMMANDS, *SUBCOMMANDS)),
    ]
    program = f"""
import contextlib, io, sys
from gelform.cli import main
for arguments in {asked!r}:
    with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.suppress(SystemExit):
        main(arguments)
    assert said.getvalue() or not arguments, arguments
    heavy = [name for name in {HEAVY!r} if name in sys.modules]
    assert not heavy, (arguments, heavy)
print("all")
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert ran.stdout == "all\n", ran.stderr


@pytest.mark.slow
def test_opencv_has_one_thread_in_a_command():
    program = """
import contextlib
from gelform.cli import main
with contextlib.suppress(SystemExit):
    main(["--version"])
import cv2
print(cv2.getNumThreads())
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stdout.split()[-1] == "1"


def test_help_has_worked_examples_that_name_real_options_and_few_of_them(run):
    for name in (*(name for name in COMMANDS if name not in BELOW), *SUBCOMMANDS[:-1]):
        code, out, _ = run(*name.split(), "--help")
        assert code == 0
        examples = [line.split() for line in out.splitlines() if line.strip().startswith(f"gelform {name}")]
        assert len(examples) >= 2
        offered = set(re.findall(r"(?<![\w-])--?[a-z][\w-]*", out.split("Options:")[1]))
        used = {word for line in examples for word in line if re.match(r"--?[a-z]", word)}
        assert used <= offered
        most = 25 if name == "batch" else 18  # batch reads and writes five kinds of data set
        assert len(re.findall(r"^  (?:-\w, )?--[a-z]", out, re.M)) <= most, name


def test_every_command_is_listed_in_its_group_and_the_version_said(run, monkeypatch):
    """In 80 columns too, where no line is cut or broken."""
    monkeypatch.setenv("COLUMNS", "80")
    said = run("--help")[1]
    listed = re.findall(r"^  ([a-z]+)  +([A-Z].+)$", said.partition("Start:")[2], re.M)
    assert tuple(name for name, _ in listed) == COMMANDS
    assert re.findall(r"^([A-Z]\w+):$", said, re.M) == ["Options", *GROUPS]
    below = said.partition("Start:")[2].splitlines()
    assert len([line for line in below if line.strip()]) == len(COMMANDS) + len(GROUPS) - 1
    helps = [run(group, "--help")[1].partition("Commands:")[2] for group in WITH_OWN]
    lines = [line for said in helps for line in re.findall(r"^  [a-z]+  +[A-Z].+$", said, re.M)]
    assert len(lines) == len(SUBCOMMANDS) - 1
    assert not [line for line in (*below, *lines) if "..." in line]
    assert run("--version")[1].strip() == f"gelform {__version__}"


def test_python_m_gelform_is_gelform():
    ran = subprocess.run([sys.executable, "-m", "gelform", "info", "missing"], capture_output=True, text=True)
    assert (ran.returncode, ran.stdout) == (1, "")
    assert ran.stderr == "gelform: error: No file or folder missing. Check the path.\n"
    usage = subprocess.run([sys.executable, "-m", "gelform", "--help"], capture_output=True, text=True)
    assert usage.stdout.startswith("Usage: gelform ")


def test_wrong_usage_is_status_2(fails):
    for arguments in ("nonsense", "calibrate", "reconstruct --nonsense", "simulate -o x --count 0"):
        fails(*arguments.split(), status=2)


def test_an_option_given_twice_is_refused_where_it_would_drop_a_value(fails, run, press_folder, tmp_path):
    rest = press_folder / "background.png"
    twice = ("--background", rest, "--background", rest)
    said = " ".join(fails("calibrate", press_folder, "-o", tmp_path / "a.npz", *twice, status=2).split())
    assert "'--background': expected once, got 2 times." in said
    assert run("info", rest, "--json", "--json")[0] == 0, "a flag drops nothing"
    assert run("force", "calibrate", "a", "-c", "b", "-c", "d")[0] == 2, "commands of a command too"
