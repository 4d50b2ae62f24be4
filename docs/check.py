"""Check the documents: every relative link resolves, every Python block of the README and docs runs.

    python docs/check.py

The blocks of a page run in order in one namespace, in a temporary folder of the page's own. A block after a line that holds
`<!-- not run` is left out: it needs hardware or a user's own files.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path

from gelform.cli import command_names

ROOT = Path(__file__).resolve().parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def broken_links(page: Path) -> list[str]:
    """Relative links of a page that lead nowhere."""
    targets = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
    relative = [target for target in targets if "://" not in target and not target.startswith("mailto:")]
    return [f"{page.relative_to(ROOT)}: {t}" for t in relative if not (page.parent / t).exists()]


def python_blocks(page: Path) -> list[tuple[int, str]]:
    """(line, code) of every Python block that is to run."""
    text = page.read_text(encoding="utf-8")
    blocks = []
    for match in re.finditer(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL):
        before = text[: match.start()].rstrip().splitlines()
        if not (before and "<!-- not run" in before[-1]):
            blocks.append((text.count("\n", 0, match.start()) + 2, match.group(1)))
    return blocks


def run_blocks(page: Path) -> None:
    """Run a page's blocks as a reader would, one after the other."""
    namespace: dict[str, object] = {"__name__": "__docs__"}
    for line, code in python_blocks(page):
        print(f"  {page.relative_to(ROOT)}:{line}", flush=True)
        exec(compile("\n" * (line - 1) + code, str(page), "exec"), namespace)


def unknown_commands(page: Path) -> list[str]:
    """`gelform NAME` in shell blocks that is no command."""
    shells = re.findall(
        r"^```(?:sh|bash)\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    used = {
        name for block in shells for name in re.findall(r"^(?:\S*/)?gelform ([a-z]+)", block, re.MULTILINE)
    }
    return [f"{page.relative_to(ROOT)}: gelform {name}" for name in sorted(used - set(command_names()))]


def main() -> int:
    """Check every page; 1 where something is wrong."""
    wrong = [problem for page in PAGES for problem in (*broken_links(page), *unknown_commands(page))]
    for problem in wrong:
        print(f"broken: {problem}")
    for page in PAGES:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            run_blocks(page)
            os.chdir(ROOT)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
