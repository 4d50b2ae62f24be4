"""Print the sentences of the documents that are longer than docs/contributing/words.md wants, and its private words.

    python docs/prose.py

A help for whoever writes, no gate: it always ends with 0. Code, tables, headings and link targets are left out.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_WORDS = 30  # words of one sentence; docs/contributing/words.md
LEFT_OUT = re.compile(
    r"^( *)```.*?^\1```|<!--.*?-->|\$\$.*?\$\$|^---.*?^---|^ *\|[^\n]*$|^#[^\n]*$", re.M | re.S
)
ONE_WORD = re.compile(r"`[^`]*`|\$[^$\n]+\$|!?\[[^\]]*\]\([^)]*\)")
ENDS = re.compile(r"(?<=[.!?:])[\"')*]*\s+(?=[\"'(*]*(?:[A-Z0-9]|gelform\b))|\n\s*\n|\n\s*(?:[-*]|\d+\.) ")
PRIVATE = re.compile(
    r"\b(doubted|doubts|otherwise than|mended|dealt into|sought|wished|whereof|thereof|begun anew)\b"
)


def main() -> None:
    """Look at all pages in English but the record of changes."""
    pages = [*ROOT.glob("[!C]*.md"), ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    for page in sorted([*pages, *(ROOT / "docs/decisions").glob("*.md")]):
        text = ONE_WORD.sub("WORD", LEFT_OUT.sub("\n", page.read_text(encoding="utf-8")))
        for sentence in map(str.split, ENDS.split(text)):
            if len(sentence) > LONGEST_WORDS:
                start = " ".join(sentence[:6])
                print(f"prose: {page.relative_to(ROOT)}: {len(sentence)} words: {start} ...")
        for word in PRIVATE.findall(text):
            print(f"prose: {page.relative_to(ROOT)}: {word}")


if __name__ == "__main__":
    main()
