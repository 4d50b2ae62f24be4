"""Every example runs as it stands, and is short."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def test_there_is_one_for_each_route():
    routes = (EXAMPLES[0].parents[1] / "docs" / "routes.md").read_text(encoding="utf-8")
    assert len(EXAMPLES) >= 8
    assert [path.name for path in EXAMPLES if f"../examples/{path.name}" not in routes] == []


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path, tmp_path):
    done = subprocess.run([sys.executable, path], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert len(path.read_text().splitlines()) <= 60
    assert "assert " in path.read_text()
