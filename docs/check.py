"""Check the documents: every relative link resolves, its heading too, every Python block of the README and docs runs.

    python docs/check.py            # all pages
    python docs/check.py PAGE.md    # that page alone
    python docs/check.py --links    # links, commands and prose only: a second
    python docs/check.py --prose    # print sentence lengths and problems of each page

The prose keeps the rules of docs/contributing/words.md, which prose.py checks; so does the spelling of source text.

A link from a name to a source file, as [`calibrate`](../src/gelform/calibration/fit.py), must lead to its definition.

The blocks of a page run in order in one namespace, in a separate temporary folder. A block after a line with
`<!-- not run` is skipped, because it needs hardware or a user's files.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from typer.main import get_command

from gelform.cli import app
from prose import prose_problems, spelling_problems, table

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / ".github").rglob("*.md")),
    ROOT / "paper/README.md",
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
]
LINK = re.compile(r"\[([^\]]*)\]\(([^)#\s]*)(?:#([^)\s]+))?\)")
BLOCK = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def broken_links(page: Path, root: Path = ROOT) -> list[str]:
    """Relative links of a page that lead nowhere: the file, the heading or the name in a source file is missing."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    found = [match for match in LINK.findall(text) if "://" not in match[1] and "mailto:" not in match[1]]
    wrong = [_broken(page, *match) for match in found]
    return [f"{page.relative_to(root)}: {problem}" for problem in wrong if problem]


def _broken(page: Path, words: str, target: str, heading: str) -> str:
    """The fault of one link, or an empty text."""
    path = page.parent / target if target else page
    if not path.exists():
        return target
    if heading and path.suffix == ".md" and heading not in headings(path):
        return f"{target}#{heading}"
    name = re.fullmatch(r"`(\w+)`", words)
    if name and path.suffix == ".py" and not _defines(path, name.group(1)):
        return f"{target} defines no {name.group(1)}"
    return ""


def headings(page: Path) -> set[str]:
    """The anchors of a page's headings, in the form of code hosting sites."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    titles = [title.lower().replace("`", "") for title in re.findall(r"^#+ (.+)$", text, re.MULTILINE)]
    return {re.sub(r"[^\w\- ]", "", title).replace(" ", "-") for title in titles}


def _defines(path: Path, name: str) -> bool:
    """Whether a source file defines a function, class or value of that name."""
    return bool(
        re.search(rf"^(?:def|class) {name}\b|^{name}\b.*=", path.read_text(encoding="utf-8"), re.MULTILINE)
    )


def python_blocks(page: Path) -> list[tuple[int, str]]:
    """(line, code) of every Python block to run."""
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


def unknown_commands(page: Path, root: Path = ROOT) -> list[str]:
    """Calls of gelform in a page's shell blocks and back-ticks whose command or option is not there."""
    text = page.read_text(encoding="utf-8")
    shells = re.findall(r"^ *```(?:sh|bash)\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    lines = "\n".join(shells).replace("\\\n", " ").splitlines() + re.findall(r"`(gelform [^`]+)`", text)
    calls = [call for line in lines for call in re.findall(r"(?:^\s*|&& )(?:\S*/)?gelform ([^#|&;]+)", line)]
    problems = {problem for call in calls if (problem := _unknown(call.split()))}
    return [f"{page.relative_to(root)}: gelform {problem}" for problem in sorted(problems)]


def _unknown(words: list[str]) -> str:
    """The command or the option of a call, without its `gelform`, that is not there; or nothing."""
    command: Any = get_command(app)
    path = ""
    while words and not words[0].startswith("-") and hasattr(command, "commands"):
        path = f"{path} {words[0]}".strip()
        if words[0] not in command.commands:
            return "" if words[0].isupper() else path
        command, words = command.commands[words[0]], words[1:]
    there = {"-h", "--help", *(option for parameter in command.params for option in parameter.opts)}
    wrong = [word for word in words if re.match(r"--?[a-z]", word) and word.partition("=")[0] not in there]
    return f"{path} {wrong[0]}" if wrong else ""


def main() -> int:
    """Check every page; return 1 if there is a fault."""
    named = [Path(name).resolve() for name in sys.argv[1:] if not name.startswith("--")]
    pages = named or PAGES
    if "--prose" in sys.argv:
        print(table(pages, ROOT))
        return 0
    wrong = [problem for page in pages for problem in (*broken_links(page), *unknown_commands(page))]
    for problem in wrong:
        print(f"broken: {problem}")
    badly_said = [*prose_problems(pages, ROOT), *([] if named else spelling_problems(ROOT))]
    for problem in badly_said:
        print(f"prose: {problem} (docs/contributing/words.md)")
    wrong += badly_said
    for page in [] if "--links" in sys.argv else pages:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            run_blocks(page)
            os.chdir(ROOT)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
