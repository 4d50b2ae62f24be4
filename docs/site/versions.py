"""The site of every version, side by side: python docs/site/versions.py FOLDER

Each tag `v...` of the repository is built from its own files, with its own gelform, into a folder of FOLDER named for
the version; what is checked out here is built into `main`. Every page lists the versions: `versions.js` beside their
folders names the pages of each, so a switch keeps the page where the other version has it, on any file server and
without one. FOLDER/index.html leads to the newest release.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MAIN = "main"
FRONT = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>gelform</title>
<meta http-equiv="refresh" content="0; url={0}/index.html">
<p><a href="{0}/index.html">gelform {0}</a></p>
</html>
"""


def write_versions(folder: Path) -> None:
    """List the versions that are in a folder: `versions.js`, and `index.html`, which leads to the newest release."""
    names = sorted((page.parent.name for page in folder.glob("*/index.html")), key=_age, reverse=True)
    pages = {
        name: sorted(
            page.relative_to(folder / name).with_suffix("").as_posix() for page in _pages(folder / name)
        )
        for name in names
    }
    text = json.dumps(pages, separators=(",", ":"))
    (folder / "versions.js").write_text(f"window.gelformVersions = {text};\n", encoding="utf-8")
    newest = next((name for name in names if name[0].isdigit()), names[0])
    (folder / "index.html").write_text(FRONT.format(newest), encoding="utf-8")


def _age(name: str) -> tuple[bool, list[int], bool]:
    """Sorts 0.10.0 after 0.9.0, 0.2.0 after 0.2.0rc1, and what is no release after all of them."""
    released = re.match(r"[\d.]+", name)
    numbers = [int(part) for part in re.findall(r"\d+", released.group(0))] if released else []
    return not released, numbers, bool(released) and released.group(0) == name


def _pages(folder: Path) -> list[Path]:
    return [page for page in folder.rglob("*.html") if "_static" not in page.parts]


def build_versions(folder: Path) -> None:
    """Build each tag, in an environment of its own, then this checkout."""
    for tag in _said("git", "tag", "--list", "v[0-9]*", "--sort=version:refname").split():
        with tempfile.TemporaryDirectory() as work:
            files, python = Path(work, "files"), Path(work, "env", "bin", "python")
            _said("git", "worktree", "add", "--detach", str(files), tag)
            try:
                _said(sys.executable, "-m", "venv", str(Path(work, "env")))
                _said(str(python), "-m", "pip", "install", "-q", f"{files}[docs]")
                _build(str(python), files, folder, tag.removeprefix("v"))
            finally:
                _said("git", "worktree", "remove", "--force", str(files))
    _build(sys.executable, ROOT, folder, MAIN)


def _build(python: str, files: Path, folder: Path, name: str) -> None:
    print(f"building {name}", flush=True)
    subprocess.run([python, files / "docs" / "site" / "build.py", folder, "--version", name], check=True)


def _said(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


if __name__ == "__main__":
    build_versions(Path(sys.argv[1]).resolve())
