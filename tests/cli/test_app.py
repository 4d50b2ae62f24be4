"""All commands: help starts at once, exit statuses, one line for a mistake.

Option values are checked when parsed, groups are flat on the command line, names are those of the tables.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path
from typing import Annotated, Optional

import pytest
import typer

import gelform
from gelform import __version__
from gelform.cli import command_names, options
from gelform.cli.app import GROUPS, app
from gelform.cli.app import SUBCOMMANDS as WITH_OWN
from gelform.cli.options import as_written, numbers, positive

COMMANDS = command_names()
BELOW = {"calibrations": ("list", "add", "remove", "export"), "force": ("calibrate", "evaluate")}
SUBCOMMANDS = (*(f"{group} {name}" for group, names in BELOW.items() for name in names), "batch verify")
HEAVY = ("numpy", "scipy", "cv2", "matplotlib", "rich")


def test_help_imports_nothing_heavy():
    """One process says after each command's help what it has brought in."""
    asked = [[], ["--version"], *([*name.split(), "--help"] for name in ("", *COMMANDS, *SUBCOMMANDS))]
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


def test_help_has_worked_examples_that_name_real_options_and_few_of_them(works):
    for name in (*(name for name in COMMANDS if name not in BELOW), *SUBCOMMANDS[:-1]):
        out = works(*name.split(), "--help")[0]
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


SOURCE = Path(gelform.__file__).parent


def test_numbers_are_read_and_others_refused():
    assert positive("1e-2") == 0.01
    assert numbers("1,2.5,-3", "A,B,C", "--x") == (1, 2.5, -3)
    for text in ("0", "-1", "nan", "inf", "six", "", "1,2"):
        with pytest.raises(typer.BadParameter, match=r"expected a number > 0, got"):
            positive(text)
    for text in ("1,2", "1,2,3,4", "1,b,3", "", "1,nan,3"):
        with pytest.raises(typer.BadParameter, match="expected A,B,C, got"):
            numbers(text, "A,B,C", "--x")


def test_the_names_are_those_of_the_tables():
    from gelform.calibration.starters import starter_names
    from gelform.exchange.importers import PACKAGES
    from gelform.simulate import LAYOUTS
    from gelform.slopes.color_models import COLOR_MODELS

    assert tuple(starter_names()) == options.STARTERS
    assert tuple(COLOR_MODELS) == options.COLOR_MODELS
    assert tuple(PACKAGES) == options.PACKAGES
    assert tuple(LAYOUTS) == options.LAYOUTS
    assert [sensor.name for sensor in LAYOUTS.values()] == list(LAYOUTS)


def test_the_help_names_them_all_as_a_sentence(run):
    assert [options.listed(tuple(names)) for names in ("a", "ab", "abc")] == ["a", "a or b", "a, b or c"]
    for command, names in (("calibrate", options.COLOR_MODELS), ("import", options.PACKAGES)):
        said = " ".join(run(command, "--help")[1].split())
        assert options.listed(names) in said.replace("auto, ", "")


def test_a_table_that_is_none_is_said():
    with pytest.raises(LookupError, match="Expected a dict THEM"):
        options.names_in("slopes/color_models/__init__.py", "THEM")
    with pytest.raises(LookupError, match="keys written out"):
        options.names_in("slopes/color_models/__init__.py", "__all__")


def test_an_options_names_are_found_on_python_3_10():
    """Its `get_type_hints` puts an Optional around an annotation whose default is None."""
    written = Annotated[int | None, typer.Option("-c")]
    assert as_written(written) == written
    assert as_written(Optional[written]) == written  # noqa: UP045 (as Python 3.10 does)
    assert as_written(int | None) == int | None


def options_of(command):
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}


def all_commands():
    main = typer.main.get_command(app)
    for name, command in main.commands.items():
        below = getattr(command, "commands", {})
        yield from ((f"{name} {inner}", one) for inner, one in below.items()) if below else [(name, command)]


def texts_of(path):
    """Texts of a module that are no docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = {ast.get_docstring(node, clean=False) for node in ast.walk(tree) if isinstance(node, kinds)}
    found = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    return [text for text in found if isinstance(text, str) and text not in docs]


def options_named_in(path):
    return {name for text in texts_of(path) for name in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)}


# Options of other programs, and of gelform itself, that messages name.
FOREIGN = {"--src", "--dst", "--dst-storage", "--list-formats-ext", "--list-ctrls", "--reload-rules"}
FOREIGN |= {"--debug", "--help", "--version", "--force-reinstall", "--no-deps"}


def test_options_that_messages_name_exist():
    known = set().union(*(options_of(command) for _, command in all_commands())) | FOREIGN
    for path in SOURCE.rglob("*.py"):
        assert options_named_in(path) <= known, (path, options_named_in(path) - known)


def test_messages_advise_no_python():
    """They reach the command line. Only what reads files that Python wrote says how to write them anew."""
    code = re.compile(
        r"\bnp\.\w|\bnumpy\.(?:moveaxis|rot90|\w*contiguous)|\b(?:image|array|frame)\[|\.astype\("
    )
    for path in SOURCE.rglob("*.py"):
        if "_native" not in path.parts:
            assert [text for text in texts_of(path) if code.search(text)] == [], path


def test_options_that_readers_of_frames_name_exist_where_frames_are_read():
    """A message of the reader of data sets reaches every command that reads frames."""
    commands = dict(all_commands())
    readers = (SOURCE / name for name in ("batch/inputs.py", "sensors/containers.py", "sensors/films.py"))
    named = set().union(*map(options_named_in, readers)) - FOREIGN - {"--keep"}
    assert "--dataset" in named
    films = ("info", "live", "record", "calibrate", "evaluate", "bag", "ros", "track")
    for command in ("batch", "reconstruct", *films):
        assert named <= options_of(commands[command]), (command, named - options_of(commands[command]))


def test_every_command_that_reads_colors_of_frames_takes_bgr():
    """Those without it read no frame, measure places in it, or one background image beside a table."""
    without = {name for name, command in all_commands() if "--bgr" not in options_of(command)}
    library = {f"calibrations {name}" for name in ("list", "add", "remove", "export")}
    no_frame = {"demo", "design", "cameras", "verify", "export", *library}
    assert without == {*no_frame, "info", "measure", "scale", "lens", "simulate", "import"}
