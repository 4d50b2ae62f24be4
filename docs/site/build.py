"""Build the documentation as a site: python docs/site/build.py [FOLDER] [--no-gallery]

Needs the extra `docs`. FOLDER, docs/_build by default, gets `html/index.html`, which loads
nothing from outside. Warnings are errors. The pages are those of the repository; the reference, the examples' pages and
the gallery are made here, the last by running the commands on a simulated sensor (some 20 s).
"""

from __future__ import annotations

import argparse
import ast
import re
import shutil
import sys
from pathlib import Path

from anchors import broken_links
from gallery import write_gallery
from links import without_files_off_the_site
from outside import requests_to_outside
from pictures import draw
from reference import write_reference

ROOT = Path(__file__).resolve().parents[2]
SECTIONS = {
    "Tutorials": ["README", "docs/index", "tutorial", "live", "examples/index", "docs/gallery"],
    "How-to": [
        "routes",
        "starters",
        "press-folder",
        "geometry",
        "background",
        "calibrations",
        "importing",
        "cameras",
        "recordings",
        "streams",
        "batch",
        "exporting",
        "simulator",
        "choosing-a-solver",
        "choosing-a-color-model",
        "adding-a-color-model",
        "adding-a-solver",
        "native",
    ],
    "中文": ["docs/zh/tutorial", "docs/zh/from-color-to-depth"],
    "Robots and learning": ["robots", "ros", "lerobot", "torch"],
    "Explanation": ["from-color-to-depth", "confidence", "contacts", "markers", "docs/decisions/index"],
    "Reference": [
        "glossary",
        "conventions",
        "calibration-report",
        "accuracy",
        "limits",
        "guarantees",
        "reference/index",
        "ARCHITECTURE",
        "CONTRIBUTING",
        "SECURITY",
        "docs/contributing/words",
        "CHANGELOG",
    ],
}


def write_pages(source: Path) -> None:
    """The repository's own pages and pictures."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        if "_build" in page.parts:
            continue
        target = source / page.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        text = page.read_text(encoding="utf-8")
        target.write_text(without_files_off_the_site(text, page, ROOT), encoding="utf-8")
    for picture in (*(ROOT / "docs").rglob("*.[pj][np]g"), *(ROOT / "benchmarks" / "results").glob("*.png")):
        target = source / picture.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(picture, target)
    decisions = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    write_index(source / "docs" / "decisions", "Decisions", [page.stem for page in decisions])


def write_examples(source: Path) -> None:
    """A page for each example: its docstring, then its code."""
    folder = source / "examples"
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for path in sorted((ROOT / "examples").glob("*.py")):
        code = path.read_text(encoding="utf-8")
        said = ast.get_docstring(ast.parse(code)) or ""
        title, _, rest = said.partition("\n")
        names.append(path.stem)
        body = code.split('"""', 2)[2].lstrip("\n")
        page = f"# {path.stem[3:].replace('_', ' ').capitalize()}\n\n{title}\n{rest}\n\n`examples/{path.name}`\n\n"
        (folder / f"{path.stem}.md").write_text(f"{page}```python\n{body}```\n", encoding="utf-8")
    write_index(folder, "Examples", names)


def write_index(folder: Path, title: str, names: list[str]) -> None:
    """A page that lists others."""
    lines = "\n".join(names)
    (folder / "index.md").write_text(
        f"# {title}\n\n```{{toctree}}\n:maxdepth: 1\n\n{lines}\n```\n", encoding="utf-8"
    )


def write_front(source: Path) -> None:
    """The first page: README without its figures, and the table of contents."""
    known = sorted(page.stem for folder in (source, source / "docs") for page in folder.glob("*.md"))
    listed = {name.rsplit("/", 1)[-1] for names in SECTIONS.values() for name in names}
    sections = {**SECTIONS, "More": [name for name in known if name not in listed]}
    readme = (source / "README.md").read_text(encoding="utf-8")
    parts = [readme.partition("\n## Figures")[0] + "\n"]
    for title, names in sections.items():
        pages = [name if "/" in name or name.isupper() else f"docs/{name}" for name in names]
        if pages:
            parts.append(
                f"```{{toctree}}\n:maxdepth: 1\n:caption: {title}\n\n" + "\n".join(pages) + "\n```\n"
            )
    (source / "index.md").write_text("\n".join(parts), encoding="utf-8")


def copy_raw_images(source: Path, html: Path) -> None:
    """Pictures that a page names in HTML of its own: Sphinx passes that on and copies nothing."""
    for page in source.rglob("*.md"):
        for address in re.findall(r'<img [^>]*src="([^":]+)"', page.read_text(encoding="utf-8")):
            target = (html / page.relative_to(source)).parent / address
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(page.parent / address, target)


def build(folder: Path, *, gallery: bool = True) -> int:
    """Write the sources below a folder, run Sphinx; its exit status, 1 where a page loads from outside or links nowhere."""
    from sphinx.cmd.build import build_main

    source, html = folder / "source", folder / "html"
    for old in (source, html):
        shutil.rmtree(old, ignore_errors=True)
    write_pages(source)
    draw(source / "docs" / "images")
    write_examples(source)
    write_reference(source / "reference")
    write_gallery(source / "docs", run=gallery)
    write_front(source)
    strict = ["-q", "-W", "--keep-going", "-E"]
    status = build_main([*strict, "-b", "html", "-c", str(Path(__file__).parent), str(source), str(html)])
    copy_raw_images(source, html)
    found = [f"loads from outside: {one}" for one in requests_to_outside(html)]
    found += [f"leads nowhere: {one}" for one in broken_links(html)]
    print("\n".join(found), end="\n" if found else "")
    return status or int(bool(found))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=ROOT / "docs" / "_build", type=Path)
    parser.add_argument("--no-gallery", action="store_true", help="leave the gallery's commands out")
    asked = parser.parse_args()
    sys.exit(build(asked.folder.resolve(), gallery=not asked.no_gallery))
