"""The check of prose finds each break of docs/contributing/words.md, and leaves plain English alone."""

from pathlib import Path

import pytest

import prose

ROOT = Path(__file__).parents[2]
LONG = "The sensor reads " + "slope and " * 15 + "depth."


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("The sensor measures depth.", []),
        (LONG, ["34 words, at most 30: The sensor reads slope and slope ..."]),
        (
            f"| a | b |\n|---|---|\n| {LONG} | x |",
            ["34 words, at most 30: The sensor reads slope and slope ..."],
        ),
        ("Of the slopes 70 % are right.", ["begin with the subject: Of the slopes 70 % are ..."]),
        ("Of course it works.", []),
        ("What is rejected has a reason.", 1),
        ("What is rejected?", []),
        ("Two files: what is rejected stays.", ["a clause for a noun: ... : what is ..."]),
        ("Such a pixel is doubted.", ["doubted: low confidence"]),
        ("The Colour is grey.", ["Colour: color", "grey: gray"]),
        ("`colour` and [a](colour.md) and\n```\ncolour\n```", []),
        ("The solver has an anchor.", ["no link to glossary.md, but the term: anchor"]),
        ("The solver has an [anchor](glossary.md).", []),
        ("The sensor reads the depth of the gel " * 2 + "once.\n\n" + "It is so. " * 3, []),
    ],
)
def test_problems(text, found):
    got = prose.problems(text)
    assert (len(got) if isinstance(found, int) else got) == found


def test_long_sentences_on_average():
    sentence = "The sensor reads the slope and the depth of the gel at each of the pixels and says it. "
    assert prose.problems(sentence * 5) == ["19.0 words in the mean, at most 18"]


def test_changes_and_other_languages_keep_no_rules(tmp_path):
    pages = [tmp_path / name for name in ("page.md", "CHANGELOG.md", "docs/zh/a.md")]
    for page in pages:
        page.parent.mkdir(parents=True, exist_ok=True)
        page.write_text("The colour.")
    assert prose.prose_problems(pages, tmp_path) == ["page.md: colour: color"]


def test_every_page_keeps_the_rules():
    pages = [
        *ROOT.glob("*.md"),
        *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
    ]
    assert prose.prose_problems(pages, ROOT) == []


def test_the_table_counts_what_a_reader_sees(tmp_path):
    (tmp_path / "page.md").write_text(f"# Title of it\n\nOne two `three four`. {LONG}\n\n- A point.\n")
    assert prose.table([tmp_path / "page.md"], tmp_path).splitlines()[1].split() == [
        "page.md", "3", "13.0", "34", "33.3%", "1",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("source", "suffix", "found"),
    [
        ('"""The colour.\n\nTwo centres.\n"""\n', ".py", [(1, "colour"), (3, "centres")]),
        ('def f():\n    """Grey."""\n    x = 1  # the neighbours\n', ".py", [(2, "Grey"), (3, "neighbours")]),
        ('def f(quantise):\n    """With quantise, `colour` is rounded."""\n', ".py", []),
        ('text = "colour"\ngrey_levels = 1\n', ".py", []),
        ("int grey;  // a grey\n", ".c", [(1, "grey")]),
    ],
)
def test_source_text_has_american_spelling(source, suffix, found):
    assert [(line, problem.split(":")[0]) for line, problem in prose.misspelled(source, suffix)] == found


def test_all_source_text_has_american_spelling():
    assert prose.spelling_problems(ROOT) == []
