"""Build the documentation as a site: python docs/site/build.py [FOLDER] [--version NAME] [--no-gallery]

Needs the extra `docs`. FOLDER, docs/_build by default, gets `html/index.html`; with --version it gets `NAME/index.html`,
beside the versions that are there already, and each page lists them all (versions.py). Warnings are errors. So is a page
that loads anything from outside, and a link that leads nowhere. The pages are those of the repository; the first page,
the reference, the examples' pages and the gallery are made here, the last by running the commands on a simulated sensor
(some 20 s). browser.py looks at the result.
"""

from __future__ import annotations

import argparse
import ast
import re
import shutil
import sys
import tempfile
from pathlib import Path

from anchors import broken_links, counted
from finish import finish
from front import write_front
from gallery import write_gallery
from links import without_files_off_the_site
from outside import requests_to_outside
from versions import write_versions

ROOT = Path(__file__).resolve().parents[2]
PICTURES = (".png", ".jpg", ".webp", ".gif")


def write_pages(source: Path) -> None:
    """The repository's own pages and pictures."""
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")):
        if "_build" in page.parts:
            continue
        target = source / page.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        text = page.read_text(encoding="utf-8")
        target.write_text(without_files_off_the_site(text, page, ROOT), encoding="utf-8")
    for picture in (*(ROOT / "docs" / "images").rglob("*"), *(ROOT / "benchmarks" / "results").glob("*")):
        if picture.suffix not in PICTURES:
            continue
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


def copy_raw_images(source: Path, html: Path) -> None:
    """Pictures that a page names in HTML of its own: Sphinx passes that on and copies nothing."""
    for page in source.rglob("*.md"):
        for address in re.findall(
            r'<(?:img|source) [^>]*src(?:set)?="([^":]+)"', page.read_text(encoding="utf-8")
        ):
            target = (html / page.relative_to(source)).parent / address
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(page.parent / address, target)


def build(folder: Path, *, version: str = "", gallery: bool = True) -> int:
    """Write the sources, run Sphinx, check the pages; 1 where a page loads from outside or links nowhere, else 0."""
    try:
        from sphinx.cmd.build import build_main

        from pictures import draw
        from reference import write_reference
    except ImportError as missing:
        raise SystemExit('The site needs the extra docs: pip install "gelform[docs]".') from missing

    html = folder / (version or "html")
    shutil.rmtree(html, ignore_errors=True)
    with tempfile.TemporaryDirectory() as work:
        source = Path(work, "source").resolve()
        write_pages(source)
        draw(source / "docs" / "images")
        write_examples(source)
        write_reference(source / "reference")
        write_gallery(source / "docs", run=gallery)
        write_front(source)
        strict = ["-q", "-W", "--keep-going", "-E"]
        how = [*strict, "-A", f"version_folder={version}", "-d", str(Path(work, "trees"))]
        status = build_main([*how, "-b", "html", "-c", str(Path(__file__).parent), str(source), str(html)])
        copy_raw_images(source, html)
    finish(html)
    if version:
        write_versions(folder)
    found = [f"loads from outside: {one}" for one in requests_to_outside(html)]
    found += [f"leads nowhere: {one}" for one in broken_links(html)]
    print("\n".join(found), end="\n" if found else "")
    print(f"{html}: {counted(html)}")
    return status or int(bool(found))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", default=ROOT / "docs" / "_build", type=Path)
    parser.add_argument(
        "--version", default="", help="name the pages' folder so, beside those of other versions"
    )
    parser.add_argument("--no-gallery", action="store_true", help="leave the gallery's commands out")
    asked = parser.parse_args()
    sys.exit(build(asked.folder.resolve(), version=asked.version, gallery=not asked.no_gallery))
