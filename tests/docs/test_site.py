"""The site is built without a warning, loads nothing from outside, and its links mean what they do in the repository."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from anchors import broken_links
from docstrings import rewrite
from links import linked_to_the_reference, without_files_off_the_site
from outside import requests_to_outside

ROOT = Path(__file__).parents[2]


def test_a_function_s_source_file_becomes_its_reference():
    text = "[`calibrate`](../src/gelform/calibration/fit.py), [`inner`](../src/gelform/depth.py)"
    assert linked_to_the_reference(text) == "{py:obj}`calibrate <gelform.calibrate>`, `inner`"


def test_links_to_what_is_no_page():
    page = ROOT / "docs" / "routes.md"
    text = "[a](tutorial.md#x) [b](../tests) [c](../examples/03_stream.py) [d](https://e.org) [e](decisions)"
    expected = "[a](tutorial.md#x) b [c](../examples/03_stream.md) [d](https://e.org) [e](decisions/index.md)"
    assert without_files_off_the_site(text, page, ROOT) == expected


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


LOADED = {  # page to how often it loads from outside
    '<script src="https://cdn.org/a.js"></script>': 1,
    '<link rel="stylesheet" href="//cdn.org/a.css">': 1,
    '<img src="https://e.org/a.png">': 1,
    "<style>@import 'https://e.org/a.css'; b { background: url(//e.org/c.png) }</style>": 2,
    '<a href="https://e.org">followed, not loaded</a><link rel="canonical" href="https://e.org/">': 0,
    '<script src="_static/a.js"></script>': 0,
}


def test_what_a_page_would_load(tmp_path):
    for page, found in LOADED.items():
        (tmp_path / "page.html").write_text(page)
        assert len(requests_to_outside(tmp_path)) == found, page


def test_links_that_lead_nowhere(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a/other.html").write_text('<h1 id="there">x</h1>')
    right = ["a/other.html#there", "#here", "https://e.org/x#y", "mailto:a@b"]
    wrong = ["a/other.html#gone", "b.html", "#nowhere"]
    body = "".join(f'<a href="{link}">x</a>' for link in (*right, *wrong))
    (tmp_path / "page.html").write_text(f'<p id="here">{body}</p>')
    assert broken_links(tmp_path) == [f"page.html: {link}" for link in wrong]


def test_the_site_is_built(tmp_path):
    pytest.importorskip("sphinx", reason="needs the extra `docs`")
    pytest.importorskip("furo", reason="needs the extra `docs`")
    pytest.importorskip("myst_parser", reason="needs the extra `docs`")
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "site" / "build.py", tmp_path, "--no-gallery"],
        capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    theory = (tmp_path / "html" / "docs" / "from-color-to-depth.html").read_text(encoding="utf-8")
    assert theory.count("<math") > 15
    assert "../reference/path.html#gelform.depth_from_gradients" in theory
    assert len(list((tmp_path / "html" / "examples").glob("0*.html"))) >= 8
    assert (tmp_path / "html" / "reference" / "streams.html").is_file()
    pages = [page for page in (tmp_path / "html").rglob("*.html") if "_static" not in page.parts]
    named = [
        (p, a) for p in pages for a in re.findall(r'<img [^>]*src="([^":]+)"', p.read_text(encoding="utf-8"))
    ]
    assert [address for page, address in named if not (page.parent / address).exists()] == []
