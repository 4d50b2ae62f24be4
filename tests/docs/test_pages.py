"""Each Python block of README and docs runs, and each command and link that no site's page holds is there.

A translation has the parts of its English page: the same blocks, formulas, pictures and rows, and a link each way.

The site is built without a warning, a broken link is one, and links mean what they do in the repository.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from docstrings import rewrite
from gelform.cli import app
from links import links_of_the_site
from versions import write_versions

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
    "```sh\ngelform calibrate a \\\n  -o cal.npz --rapport report  # --no\n```": ["calibrate --rapport"],
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


DOCS = ROOT / "docs"
PARTS = {
    "blocks of code": r"^```.*?^```",
    "displayed formulas": r"^\$\$.*?^\$\$",
    "names of functions": r"(?<=\[)`\w+`(?=\]\()",
}
COUNTED = {"headings": r"^#+ ", "rows": r"^\|", "pictures": r"^!\[", "points": r"^- "}


def parts(rule, text):
    return re.findall(rule, text, re.MULTILINE | re.DOTALL)


def decimals(text):
    return sorted(re.findall(r"\d+\.\d+", text))


@pytest.mark.parametrize("page", sorted((DOCS / "zh").glob("*.md")), ids=lambda page: page.stem)
def test_a_translation_has_all_parts_of_its_page(page):
    translated, english = (path.read_text(encoding="utf-8") for path in (page, DOCS / page.name))
    first = translated.splitlines()[2]
    assert re.search(rf"\(\.\./{page.name}\).*\d{{4}}-\d\d-\d\d.*[0-9a-f]{{7}}", first)
    assert f"(zh/{page.name})" in english
    for name, rule in PARTS.items():
        assert parts(rule, translated) == parts(rule, english), name
    for name, rule in COUNTED.items():
        assert len(parts(rule, translated)) == len(parts(rule, english)), name
    assert decimals(translated) == decimals(english)


LINKS = {
    "[`calibrate`](../src/gelform/calibration/fit.py)": "{py:obj}`calibrate <gelform.calibrate>`",
    "[`zero_region`](../src/gelform/depth/integrate.py)": "`zero_region`",
    "[a](tutorial.md#x)": "[a](tutorial.md#x)",
    "[b](../tests)": "b",
    "[c](../examples/03_stream.py)": "[c](../examples/03_stream.md)",
    "[d](https://e.org)": "[d](https://e.org)",
    "[e](decisions)": "[e](decisions/index.md)",
    "![f](images/coin.png)": "![f](images/coin.png)",
    "```\n[a](gone.md)\n```": "```\n[a](gone.md)\n```",
}
WRONG = {
    "[a](gone.md)": "leads nowhere: gone.md",
    "[b](../tests/gone)": "leads nowhere: ../tests/gone",
    "[`lost`](../src/gelform/depth/integrate.py)": "defines no lost",
}


@pytest.mark.parametrize("text", LINKS)
def test_links_on_the_site(text):
    said = []
    assert links_of_the_site(text, ROOT / "docs" / "routes.md", said.append) == LINKS[text]
    assert said == []


@pytest.mark.parametrize("text", WRONG)
def test_links_that_lead_nowhere(text):
    said = []
    links_of_the_site(text, ROOT / "docs" / "routes.md", said.append)
    assert [WRONG[text] in one for one in said] == [True]


def test_entries_and_stars_of_docstrings():
    """A description that is no type goes below its name; a shape before a sentence gets its full stop."""
    lines = [
        "Open *.mcap.",
        "",
        "Parameters",
        "----------",
        "a, b : (N, 2) px",
        "    more",
        "",
        "x : no entry",
    ]
    rewrite(lines)
    assert lines[0] == r"Open \*.mcap."
    assert lines[4:7] == ["a, b", "    (N, 2) px", "    more"]
    lines = [
        "Returns",
        "-------",
        "mask : (H, W) bool",
        "    Pixels of the surface.",
        "depth_mm : (H, W), mm",
    ]
    rewrite(lines)
    below = ["    (H, W) bool.", "    Pixels of the surface."]
    assert lines[2:] == ["``mask``", *below, "``depth_mm``", "    (H, W), mm"]


def test_the_versions_of_a_folder(tmp_path):
    for name in ("0.9.0", "0.10.0", "main", "0.10.0rc1"):
        (tmp_path / name / "docs").mkdir(parents=True)
        (tmp_path / name / "index.html").write_text("x")
    (tmp_path / "main/docs/new.html").write_text("x")
    write_versions(tmp_path)
    text = (tmp_path / "versions.js").read_text()
    listed = json.loads(text.removeprefix("window.gelformVersions = ").removesuffix(";\n"))
    assert list(listed) == ["main", "0.10.0", "0.10.0rc1", "0.9.0"]
    assert listed["main"] == ["docs/new", "index"]
    assert 'url=0.10.0/index.html"' in (tmp_path / "index.html").read_text()


@pytest.mark.slow
def test_the_site_is_built(tmp_path):
    for package in ("sphinx", "furo", "myst_parser"):
        pytest.importorskip(package, reason="needs the extra `docs`")
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "site" / "build.py", tmp_path],
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    site = tmp_path / "html"
    theory = (site / "docs" / "from-color-to-depth.html").read_text(encoding="utf-8")
    assert theory.count("<math") > 15
    assert "../reference/path.html#gelform.depth_from_gradients" in theory
    chinese = (site / "docs" / "zh" / "tutorial.html").read_text(encoding="utf-8")
    assert [re.search(r"<html[^>]* lang=\"(\w+)\"", page)[1] for page in (theory, chinese)] == ["en", "zh"]
    names = (ROOT / "src" / "gelform" / "__init__.pyi").read_text(encoding="utf-8")
    interface = "".join(page.read_text(encoding="utf-8") for page in (site / "reference").glob("*.html"))
    public = re.findall(r"^from .* as (\w+)$", names, re.MULTILINE)
    assert [name for name in public if f'id="gelform.{name}"' not in interface] == []
    front = (site / "index.html").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert front.count("<tr") == len(re.findall(r"^\|[^-]", readme, re.MULTILINE))
