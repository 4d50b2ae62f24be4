"""gelform design: the table and its mistakes."""

import pytest

SMALL = 'base = "ring-120"\nshape = [120, 160]\nmm_per_px = 0.1268\n'


def test_a_misspelt_sensor_is_one_line(fails, tmp_path):
    (tmp_path / "bad.toml").write_text(SMALL + "noise_ds = 3\n")
    assert "Did you mean 'noise_sd'" in fails("design", tmp_path / "bad.toml")
    assert "No file" in fails("design", tmp_path / "none.toml")


@pytest.mark.slow
def test_the_designs_are_compared(run_json, tmp_path, monkeypatch):
    from gelform.design import study as design

    pytest.importorskip("matplotlib")
    monkeypatch.setattr(design.compare_designs, "__defaults__", (design.VARIATIONS[:1],))
    (tmp_path / "mine.toml").write_text(SMALL)
    said = run_json("design", tmp_path / "mine.toml", "--presses", "8", "-o", tmp_path / "study.png")
    assert [row["design"] for row in said["designs"]] == ["as given"]
    assert 0 < said["designs"][0]["depth_rmse_um"] < 500
    assert (tmp_path / "study.png").stat().st_size > 10_000
