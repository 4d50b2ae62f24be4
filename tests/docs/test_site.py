"""The site is built without a warning, a broken link is one, and links mean what they do in the repository."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from docstrings import rewrite
from links import links_of_the_site
from versions import write_versions

ROOT = Path(__file__).parents[2]
LINKS = {
    "[`calibrate`](../src/gelform/calibration/fit.py)": "{py:obj}`calibrate <gelform.calibrate>`",
    "[`zero_region`](../src/gelform/depth/zero.py)": "`zero_region`",
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


def test_descriptions_and_stars_of_docstrings():
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


def test_a_sentence_below_a_shape_begins_after_a_full_stop():
    lines = [
        "Returns",
        "-------",
        "mask : (H, W) bool",
        "    Pixels of the surface.",
        "depth_mm : (H, W), mm",
    ]
    rewrite(lines)
    assert lines[2:] == [
        "``mask``",
        "    (H, W) bool.",
        "    Pixels of the surface.",
        "``depth_mm``",
        "    (H, W), mm",
    ]


def test_the_versions_of_a_folder(tmp_path):
    for name in ("0.9.0", "0.10.0", "main", "0.10.0rc1"):
        (tmp_path / name / "docs").mkdir(parents=True)
        (tmp_path / name / "index.html").write_text("x")
    (tmp_path / "main/docs/new.html").write_text("x")
    write_versions(tmp_path)
    text = (
        (tmp_path / "versions.js").read_text().removeprefix("window.gelformVersions = ").removesuffix(";\n")
    )
    listed = json.loads(text)
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
