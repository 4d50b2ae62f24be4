"""The check of the documents finds links that lead nowhere."""

import importlib.util
from pathlib import Path

import pytest

CHECK = Path(__file__).parents[2] / "docs" / "check.py"


@pytest.fixture(scope="module")
def check():
    spec = importlib.util.spec_from_file_location("docs_check", CHECK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LINKS = {
    "[a](other.md)": True,
    "[a](gone.md)": False,
    "[a](other.md#its-heading-twice)": True,
    "[a](other.md#no-heading)": False,
    "[`found`](code.py)": True,
    "[`lost`](code.py)": False,
    "[a](https://e.org/gone)": True,
    "```\n[a](gone.md)\n```": True,
}


def test_links(check, tmp_path):
    (tmp_path / "other.md").write_text("# Other\n\n## Its `heading`, twice\n")
    (tmp_path / "code.py").write_text("def found():\n    pass\n")
    for link, right in LINKS.items():
        (tmp_path / "page.md").write_text(f"# Page\n\n{link}\n")
        assert (check.broken_links(tmp_path / "page.md", tmp_path) == []) == right, link


def test_every_page_s_links(check):
    assert [problem for page in check.PAGES for problem in check.broken_links(page)] == []


CALLS = {
    "`gelform info --system --json`": [],
    "`gelform inform FILE`": ["page.md: gelform inform"],
    "```sh\npip install . && gelform info --sistem | less\n```": ["page.md: gelform info --sistem"],
    "```sh\ngelform calibrate presses \\\n  -o cal.npz --rapport report  # --no such thing\n```": [
        "page.md: gelform calibrate --rapport"
    ],
    "`gelform calibrations lost`": ["page.md: gelform calibrations lost"],
    "`gelform calibrations list`": [],
    "`gelform NAME --help`": [],
}


@pytest.mark.parametrize("text", CALLS)
def test_commands_and_options(check, tmp_path, text):
    (tmp_path / "page.md").write_text(f"# Page\n\n{text}\n")
    assert check.unknown_commands(tmp_path / "page.md", tmp_path) == CALLS[text]


def test_every_page_and_form_names_commands_that_are_there(check):
    pages = [*check.PAGES, *(check.ROOT / ".github").rglob("*.yml")]
    assert [problem for page in pages for problem in check.unknown_commands(page)] == []
