"""Each Python block of README and docs runs, and each command and link that no site's page holds is there."""

import re
from pathlib import Path

import pytest
from typer.main import get_command

from gelform.cli import app

ROOT = Path(__file__).parents[2]
FORMS = [*(ROOT / ".github").rglob("*.md"), *(ROOT / ".github").rglob("*.yml")]
PAGES = [*ROOT.glob("*.md"), ROOT / "paper/README.md", *(ROOT / "docs").rglob("*.md")]
PAGES = sorted(page for page in PAGES if not {"_build", "site"} & set(page.relative_to(ROOT).parts))


def blocks(page):
    """(line, code) of the blocks to run: not those below a line with `<!-- not run`, which need hardware or files."""
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    before = [(match, text[: match.start()].rstrip().rpartition("\n")[2]) for match in found]
    return [(text.count("\n", 0, m.start()) + 1, m[1]) for m, line in before if "<!-- not run" not in line]


def name_of(page):
    return page.relative_to(ROOT).as_posix()


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page)], ids=name_of)
def test_the_blocks_of_a_page_run_in_order(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    namespace = {"__name__": "__docs__"}
    for line, code in blocks(page):
        exec(compile("\n" * line + code, str(page), "exec"), namespace)


def unknown_commands(text):
    """Calls of gelform in shell blocks and back-ticks whose command or option is not there."""
    shells = re.findall(r"^ *```(?:sh|bash)\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    lines = "\n".join(shells).replace("\\\n", " ").splitlines() + re.findall(r"`(gelform [^`]+)`", text)
    calls = [call for line in lines for call in re.findall(r"(?:^\s*|&& )(?:\S*/)?gelform ([^#|&;]+)", line)]
    return sorted({problem for call in calls if (problem := unknown(call.split()))})


def unknown(words):
    """The command or the option of a call, without its `gelform`, that is not there; or nothing."""
    command, path = get_command(app), ""
    while words and not words[0].startswith("-") and hasattr(command, "commands"):
        path = f"{path} {words[0]}".strip()
        if words[0] not in command.commands:
            return "" if words[0].isupper() else path
        command, words = command.commands[words[0]], words[1:]
    there = {"-h", "--help", *(option for parameter in command.params for option in parameter.opts)}
    wrong = [word for word in words if re.match(r"--?[a-z]", word) and word.partition("=")[0] not in there]
    return f"{path} {wrong[0]}" if wrong else ""


CALLS = {
    "`gelform info --system --json`": [],
    "`gelform inform FILE`": ["inform"],
    "```sh\npip install . && gelform info --sistem | less\n```": ["info --sistem"],
    "```sh\ngelform calibrate presses \\\n  -o cal.npz --rapport report  # --no such\n```": [
        "calibrate --rapport"
    ],
    "`gelform calibrations lost`": ["calibrations lost"],
    "`gelform NAME --help`": [],
}


@pytest.mark.parametrize("text", CALLS)
def test_commands_and_options(text):
    assert unknown_commands(text) == CALLS[text]


@pytest.mark.parametrize("page", [*PAGES, *FORMS], ids=name_of)
def test_a_page_names_commands_that_are_there(page):
    assert unknown_commands(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "paper/README.md", *FORMS], ids=name_of)
def test_files_behind_the_links_of_pages_off_the_site(page):
    """Sphinx follows the links of all other pages, and README's anchors."""
    targets = re.findall(r"\]\((?!\w+:)([^)#\s]+)", page.read_text(encoding="utf-8"))
    assert [target for target in targets if not (page.parent / target).exists()] == []
