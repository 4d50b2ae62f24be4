"""gelform demo, with a smaller sensor and fewer presses than on the command line."""

import json

import pytest
from tests.cli.conftest import SMALL

from gelform.cli.commands import demo
from gelform.result import load_result
from gelform.simulate import LAYOUTS

pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")


@pytest.mark.slow
def test_the_whole_path_and_its_errors(run_json, fails, monkeypatch, tmp_path):
    monkeypatch.setitem(LAYOUTS, "small", SMALL)
    monkeypatch.setattr(demo, "LAYOUT", "small")
    monkeypatch.setattr(demo, "PRESSES", 8)
    said = run_json("demo", "-o", tmp_path / "d")
    names = {path.relative_to(tmp_path / "d").as_posix() for path in (tmp_path / "d").rglob("*.*")}
    assert {"ball.png", "coin.png", "screw.png", "border.png", "report/report.html"} <= names
    assert json.loads((tmp_path / "d" / "errors.json").read_text()) == said["errors"]
    assert abs(said["errors"]["ball"]["peak_ratio"] - 1) < 0.15
    assert said["errors"]["ball"]["rmse_um"] < 40
    assert load_result(tmp_path / "d" / "border.npz").contact.any()
    assert "holds something" in fails("demo", "-o", tmp_path / "d")
