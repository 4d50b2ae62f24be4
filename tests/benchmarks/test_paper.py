"""The paper quotes the recorded results, and no other figure."""

import re
from pathlib import Path

import pytest

import paper

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "paper/paper.md").read_text(encoding="utf-8").split("---\n", 2)[2]
PLAIN = " ".join(TEXT.split())
NOT_MEASURED = (
    r"@\w+", r"!\[.*?\]\(.*?\)\{.*?\}", r"\|[:|-]+\|", "[Ff]igure 1", r"Tables? \d", "ROS 2", r"py3DCal", "3D printer",
    r"\(deg\)",
)  # fmt: skip


def without_quotes(text):
    """The text without the quotes, names and numbers of figures."""
    for quote in paper.quotes():
        text = text.replace(quote, "")
    for name in NOT_MEASURED:
        text = re.sub(name, "", text)
    return text


def test_each_quote_is_there():
    assert [quote for quote in paper.quotes() if quote not in PLAIN] == []


def test_there_is_no_other_figure():
    assert re.findall(r".{0,30}\d.{0,10}", without_quotes(PLAIN)) == []


@pytest.mark.parametrize("added", ["It takes 3 ms.", "Table 1 shows 12 %."])
def test_another_figure_is_found(added):
    assert re.search(r"\d", without_quotes(f"{PLAIN} {added}"))


def test_each_reference_is_cited_and_there():
    entries = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "paper/paper.bib").read_text(encoding="utf-8"), re.M))
    assert set(re.findall(r"@(\w+)", TEXT)) == entries
