"""Build the documentation as a site: python docs/site/build.py [FOLDER] [--version NAME] [--builder html | linkcheck]

Needs the extra `docs`. FOLDER, docs/_build by default, gets `html/index.html`; with --version it gets `NAME/index.html`,
beside the versions that are there already, and each page lists them all (versions.py). Sphinx checks links, anchors and
the tables of contents, and every warning is an error. The pages are those of the repository and of `pages/`; the
reference and the examples' pages are made here. `--builder linkcheck` asks the other sites that pages link to.
browser.py looks at the result.
"""

from __future__ import annotations

import argparse
import ast
import shutil
import sys
import tempfile
from pathlib import Path

from versions import write_versions

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
COPIED = ("*.md", "docs/**/*.md", "docs/images/**/*.*", "benchmarks/results/*.png")


def write_sources(source: Path) -> None:
    """The repository's own pages and pictures, those of `pages/`, and a page for each example."""
    shutil.copytree(HERE / "pages", source)
    for path in {path for pattern in COPIED for path in ROOT.glob(pattern)}:
        if HERE not in path.parents and "_build" not in path.parts:
            target = source / path.relative_to(ROOT)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    for path in (ROOT / "examples").glob("*.py"):
        code = path.read_text(encoding="utf-8")
        said, title = ast.get_docstring(ast.parse(code)), path.stem[3:].replace("_", " ").capitalize()
        code = code.split('"""', 2)[2].lstrip("\n")
        page = f"# {title}\n\n{said}\n\n`examples/{path.name}`\n\n```python\n{code}```\n"
        (source / "examples" / f"{path.stem}.md").write_text(page, encoding="utf-8")


def build(folder: Path, *, version: str = "", builder: str = "html") -> int:
    """Write the sources and run Sphinx, whose status is returned: 0 where it has nothing to say."""
    try:
        from sphinx.cmd.build import build_main

        from reference import write_reference
    except ImportError as missing:
        raise SystemExit('The site needs the extra docs: pip install "gelform[docs]".') from missing

    html = folder / (version or builder)
    shutil.rmtree(html, ignore_errors=True)
    with tempfile.TemporaryDirectory() as work:
        source = Path(work, "source").resolve()
        write_sources(source)
        write_reference(source / "reference")
        how = ["-q", "-W", "--keep-going", "-E", "-A", f"version_folder={version}", "-d", f"{work}/trees"]
        status = build_main([*how, "-b", builder, "-c", str(HERE), str(source), str(html)])
    if version:
        write_versions(folder)
    return status


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", default=ROOT / "docs" / "_build", type=Path)
    parser.add_argument("--version", default="", help="the pages' folder, beside those of other versions")
    parser.add_argument("--builder", default="html", help="html, or linkcheck")
    asked = parser.parse_args()
    sys.exit(build(asked.folder.resolve(), version=asked.version, builder=asked.builder))
