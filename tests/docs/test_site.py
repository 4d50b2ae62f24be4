"""The site is built without a warning, loads nothing from outside, and its links mean what they do in the repository."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from anchors import broken_links, counted
from docstrings import rewrite
from finish import CHANGES, finish, opening_pictures
from front import DOORS, found, sections_of, write_front
from links import linked_to_the_reference, without_files_off_the_site
from outside import requests_to_outside
from versions import write_versions

ROOT = Path(__file__).parents[2]


def test_a_function_s_source_file_becomes_its_reference():
    text = "[`calibrate`](../src/gelform/calibration/fit.py), [`inner`](../src/gelform/depth.py)"
    assert linked_to_the_reference(text) == "{py:obj}`calibrate <gelform.calibrate>`, `inner`"


def test_links_to_what_is_no_page():
    page = ROOT / "docs" / "routes.md"
    text = "[a](tutorial.md#x) [b](../tests) [c](../examples/03_stream.py) [d](https://e.org) [e](decisions) ![f](a.webp)"
    expected = "[a](tutorial.md#x) b [c](../examples/03_stream.md) [d](https://e.org) [e](decisions/index.md) ![f](a.webp)"
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


LOADED = {  # page to how often it loads from outside
    '<script src="https://cdn.org/a.js"></script>': 1,
    '<link rel="stylesheet" href="//cdn.org/a.css">': 1,
    '<img src="https://e.org/a.png">': 1,
    "<style>@import 'https://e.org/a.css'; b { background: url(//e.org/c.png) }</style>": 2,
    '<a href="https://e.org">followed, not loaded</a><link rel="canonical" href="https://e.org/">': 0,
    '<script src="_static/a.js"></script>': 0,
}


def test_what_a_page_would_load(tmp_path):
    for page, times in LOADED.items():
        (tmp_path / "page.html").write_text(page)
        assert len(requests_to_outside(tmp_path)) == times, page


def test_links_that_lead_nowhere(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a/other.html").write_text('<h1 id="there">x</h1>')
    right = ["a/other.html#there", "#here", "https://e.org/x#y", "mailto:a@b"]
    wrong = ["a/other.html#gone", "b.html", "#nowhere"]
    body = "".join(f'<a href="{link}">x</a>' for link in (*right, *wrong))
    loads = '<img src="a/gone.png"><source srcset="gone.webp"><script src="gone.js"></script>'
    (tmp_path / "page.html").write_text(f'<p id="here">{body}</p>{loads}')
    lost = [*wrong, "a/gone.png", "gone.webp", "gone.js"]
    assert broken_links(tmp_path) == [f"page.html: {link}" for link in lost]
    assert counted(tmp_path).startswith("2 pages, 8 links within them, 4 to a place on a page; 2 to other")


README = """# gelform

One sentence. Another.

![a picture](docs/images/coin.png)

Install it from a checkout:

```sh
pip install .
```

The Python interface.

## Figures

| surface | gelform |
|---|---|
| bump | **99.98 %** |

## Limits
"""


def test_the_first_page_has_the_words_and_the_table_of_the_readme(tmp_path):
    index = "# All\n\n## Tutorials: learn\n\n- [x](tutorial.md)\n\n## Reference: look up\n\n[y](words.md#a)\n"
    for name, text in {
        "README": README,
        "docs/index": index,
        "docs/tutorial": "# x",
        "docs/new": "# x",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.md").write_text(text)
    write_front(tmp_path)
    front = (tmp_path / "index.md").read_text()
    assert "\n\nOne sentence. Another.\n\n" in front
    assert "| bump | **99.98 %** |" in front
    assert "pip install .\n```" in front
    assert '<img src="docs/images/coin.png" alt="a picture">' in front
    assert "The Python interface" not in front
    assert [front.count(f'href="{door[1]}">{door[0]}<') for door in DOORS] == [1, 1, 1]
    assert "docs/new" in front.partition(":caption: More")[2], (
        "a page that docs/index.md leaves out is listed too"
    )
    assert front.count("\ndocs/tutorial\n") == 1
    with pytest.raises(SystemExit, match="## Figures"):
        found(r"^(?P<kept>## Figures\n)", "# gelform\n", "a section `## Figures`")


def test_the_navigation_has_the_sections_of_the_index():
    sections = sections_of((ROOT / "docs" / "index.md").read_text(encoding="utf-8"))
    assert list(sections) == [
        "Tutorials", "How-to", "Robots and learning", "Explanation", "Reference", "中文",
    ]  # fmt: skip
    assert sections["Robots and learning"] == ["docs/robots", "docs/ros", "docs/lerobot", "docs/torch"]
    assert sections["中文"] == ["docs/zh/tutorial", "docs/zh/from-color-to-depth"]
    assert "ARCHITECTURE" in sections["Reference"]


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


def test_pictures_lead_to_their_files():
    alone = '<img alt="a" src="_images/a.png" />'
    inside = '<a href="x.html"><img src="b.png" /></a><picture><source srcset="c"><img src="d.png"></picture>'
    assert opening_pictures(f"{alone}{inside}") == f'<a href="_images/a.png">{alone}</a>{inside}'


def test_a_theme_that_has_changed_is_an_error(tmp_path):
    whole = "".join(CHANGES) + '<div id="search-results"></div><article role="main">'
    (tmp_path / "page.html").write_text(whole)
    finish(tmp_path)
    page = (tmp_path / "page.html").read_text()
    assert 'role="heading" aria-level="2"' in page
    assert "<h1" in page
    (tmp_path / "page.html").write_text(whole.replace("caption", "headline"))
    with pytest.raises(SystemExit, match="caption"):
        finish(tmp_path)


@pytest.mark.slow
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
    chinese = list((tmp_path / "html" / "docs" / "zh").glob("*.html"))
    assert chinese
    for page in (tmp_path / "html").rglob("*.html"):
        lang = "zh" if page in chinese else "en"
        assert re.search(r"<html[^>]* lang=\"(\w+)\"", page.read_text(encoding="utf-8")).group(1) == lang, (
            page
        )
    assert "../reference/path.html#gelform.depth_from_gradients" in theory
    assert len(list((tmp_path / "html" / "examples").glob("0*.html"))) >= 8
    assert (tmp_path / "html" / "reference" / "streams.html").is_file()
    names = (ROOT / "src" / "gelform" / "__init__.pyi").read_text(encoding="utf-8")
    interface = (tmp_path / "html" / "reference" / "index.html").read_text(encoding="utf-8")
    public = re.findall(r"^from .* as (\w+)$", names, re.MULTILINE)
    assert [name for name in public if f"#gelform.{name}" not in interface] == []
    front = (tmp_path / "html" / "index.html").read_text(encoding="utf-8")
    assert front.count("<tr") == (ROOT / "README.md").read_text(encoding="utf-8").count("\n|") - 1
