"""A translation has the parts of its English page: the same blocks, formulas, pictures and rows, and a link each way."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PARTS = {
    "blocks of code": r"^```.*?^```",
    "displayed formulas": r"^\$\$.*?^\$\$",
    "names of functions": r"(?<=\[)`\w+`(?=\]\()",
}
COUNTED = {"headings": r"^#+ ", "rows": r"^\|", "pictures": r"^!\[", "points": r"^- "}


def parts(rule, text):
    return re.findall(rule, text, re.MULTILINE | re.DOTALL)


def decimals(text):
    return sorted(re.findall(r"\d+\.\d+", text))


@pytest.mark.parametrize("page", sorted((DOCS / "zh").glob("*.md")), ids=lambda page: page.stem)
def test_a_translation_has_all_parts_of_its_page(page):
    translated, english = (path.read_text(encoding="utf-8") for path in (page, DOCS / page.name))
    first = translated.splitlines()[2]
    assert re.search(rf"\(\.\./{page.name}\).*\d{{4}}-\d\d-\d\d.*[0-9a-f]{{7}}", first)
    assert f"(zh/{page.name})" in english
    for name, rule in PARTS.items():
        assert parts(rule, translated) == parts(rule, english), name
    for name, rule in COUNTED.items():
        assert len(parts(rule, translated)) == len(parts(rule, english)), name
    assert decimals(translated) == decimals(english)
