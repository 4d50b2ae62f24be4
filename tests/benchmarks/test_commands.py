"""Each benchmark reads its command line with argparse, so `--help` says what it does and measures nothing."""

from pathlib import Path

import pytest

SCRIPTS = [
    path
    for path in sorted(Path(__file__).parents[2].joinpath("benchmarks").glob("*.py"))
    if "__main__" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_it_has_a_command_line(script):
    text = script.read_text(encoding="utf-8")
    assert "parse_args()" in text or "parts_asked(" in text
