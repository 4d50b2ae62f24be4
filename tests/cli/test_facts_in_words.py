"""`gelform info` speaks in words: no raw arrays, and every file of today and of the first version has its lines."""

import re
from pathlib import Path

import pytest

from gelform.cli.facts_in_words import lines_of

VERSION_1 = Path(__file__).parents[1] / "data" / "calibration-version-1.npz"


def test_a_calibration_in_words(run, calibration_file):
    lines = dict(line.split("  ", 1) for line in run("info", calibration_file)[1].splitlines())
    said = {label.strip(): text.strip() for label, text in lines.items()}
    assert said["images"].startswith(
        "120x160 px (height x width), 0.1268 mm per pixel, its uncertainty not known"
    )
    assert said["made from"] == "10 presses"
    assert "normals" in said["held out"]
    assert "\N{DEGREE SIGN}" in said["held out"]
    assert "at rest" in said["slope noise"]
    assert max(len(text) for text in said.values()) < 140


def test_a_calibration_of_the_first_version(run):
    code, out, _ = run("info", VERSION_1)
    assert code == 0
    assert "24x32 px" in out


def test_a_result_in_words(run, calibration_file, press_folder, tmp_path):
    image = press_folder / "images" / "0001.png"
    assert run("reconstruct", image, "-c", calibration_file, "-o", tmp_path, "-q")[0] == 0
    out = run("info", tmp_path / "0001.npz")[1]
    assert " mm, 0 at rest" in out
    assert "100 % of the pixels" in out
    assert re.search(
        r"roughness +Sa [\d.]+ um, .* form removed: quadratic, S-filter 0\.38 mm", " ".join(out.split())
    )
    assert re.search(r"contact 1 +[\d.]+ mm², [\d.]+ mm³, axes [\d.]+ x [\d.]+ mm, [\d.]+ mm deep at", out)


def test_what_is_unknown_is_said():
    facts = {
        "kind": "result", "size_px": [2, 4], "mm_per_px": None, "mm_per_px_sigma": None, "depth_px": [0.0, 2.5],
        "contact_px": 3, "known_px": 4, "zero": "mean", "solver": "dct", "curl_rms": 0.01,
        "findings": ["It is dark."], "calibration": "0",
        "contacts": [{"area_px": 3, "area_mm2": None, "deepest_px": (1, 0), "cut_by_border": True}],
        "markers": {"in_words": "2 of 3 seen"},
    }  # fmt: skip
    said = lines_of(facts)
    assert ("depth", "0.000 to 2.500 px, 0 at rest, zero by: mean") in said
    assert ("warning", "It is dark.") in said
    assert ("markers", "2 of 3 seen") in said
    assert ("known", "50 % of the pixels; the others are filled") in said
    assert any("scale unknown" in text for _, text in said)
    assert ("contact 1", "3 px, deepest at (1, 0), cut by the image's border") in said


@pytest.mark.parametrize("kind", ["image", "video", "press folder"])
def test_other_kinds_are_listed(kind):
    said = lines_of({"kind": kind, "size_px": (3, 4), "balls_mm": {"6": 5}, "missing": ["a", "b"]})
    assert said == [
        ("kind", kind), ("size", "3x4 px (height x width)"), ("balls mm", "6: 5"), ("missing", "a"), ("missing", "b"),
    ]  # fmt: skip
