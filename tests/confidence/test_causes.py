"""The table of causes: each is said in words, and everything that lists them lists them all."""

import re
from pathlib import Path

import pytest

from gelform.cli.commands.inspection.explain import explain
from gelform.confidence.causes import CAUSES

PAGE = Path(__file__).resolve().parents[2] / "docs" / "confidence.md"


@pytest.mark.parametrize("name", CAUSES)
def test_what_is_said_of_pixels_is_a_sentence(name):
    """After "5 % of the frame is ": no capital, and an end."""
    sentence = CAUSES[name].sentence
    if name == "wall":  # no fault: never named
        assert sentence == ""
    else:
        assert re.fullmatch(r"[a-z].*[.?]", sentence)


def test_less_than_a_press_shows_itself_is_not_named():
    assert all(cause.named_from > 0.3 for name, cause in CAUSES.items() if name != "compression")


def test_page_and_command_list_them_all_in_their_order():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert rows == list(CAUSES)
    listed = re.search(r"each named cause: (.*?)\. With", " ".join(explain.__doc__.split()))[1].split(", ")
    assert sorted(listed) == sorted(CAUSES)
