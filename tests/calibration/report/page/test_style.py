"""The style sheet: whole, and nothing in it is fetched from elsewhere."""

import re

from gelform.calibration.report.page.style import STYLE


def test_nothing_comes_from_outside():
    assert not re.search(r"url\(|@import|https?:|//", STYLE)


def test_every_bracket_is_closed_and_every_color_is_named():
    assert STYLE.count("{") == STYLE.count("}")
    used, defined = (set(re.findall(form, STYLE)) for form in (r"var\((--[\w-]+)\)", r"(--[\w-]+):"))
    assert used - {"--aspect"} <= defined  # that one is written beside each picture
    assert "prefers-color-scheme:dark" in STYLE
