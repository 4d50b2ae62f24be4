"""Every example runs unchanged, asserts something, and is short."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
QUICK = ("01_photometric_stereo", "02_why_least_squares")  # calibrate nothing


def test_there_is_one_for_each_route():
    routes = (EXAMPLES[0].parents[1] / "docs" / "routes.md").read_text(encoding="utf-8")
    assert len(EXAMPLES) >= 8
    assert [path.name for path in EXAMPLES if f"../examples/{path.name}" not in routes] == []
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) <= 60, path
        assert "assert " in path.read_text(), path


@pytest.mark.parametrize(
    "path",
    [pytest.param(one, marks=() if one.stem in QUICK else pytest.mark.slow) for one in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example_runs(path, tmp_path):
    done = subprocess.run([sys.executable, path], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
