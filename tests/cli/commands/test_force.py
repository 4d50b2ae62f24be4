"""gelform force calibrate and evaluate: what they write and print, and what they refuse."""

import re
import shutil

import cv2
import numpy as np
import pytest

import gelform
from gelform.simulate import Ball, simulate_press

DEPTHS_MM, K = (0.15, 0.25, 0.35, 0.5), 0.05


@pytest.fixture(scope="module")
def loads(small, calibration_file, tmp_path_factory):
    """Two balls with four loads each, K times the volume that the calibration reads."""
    folder, rng = tmp_path_factory.mktemp("loads"), np.random.default_rng(9)
    reconstruct, lines = gelform.Reconstructor(gelform.load_calibration(calibration_file)), []
    for radius in (2.5, 4.0):
        for depth in DEPTHS_MM:
            press = simulate_press(
                small, Ball(radius), depth_mm=depth, center_mm=(0.4, -0.3), rng=rng, oversample=1
            )
            name = f"{radius}-{depth}.png"
            cv2.imwrite(str(folder / name), press.image[..., ::-1])
            lines.append(
                f"{name},ball {radius},{K * gelform.touch_from_result(reconstruct(press.image)).volume_mm3}"
            )
    (folder / "loads.csv").write_text("\n".join(["image,object,force_n", *lines, ""]))
    return folder


def test_loads_are_added_to_the_calibration_and_measured(run, run_json, loads, calibration_file, tmp_path):
    own = shutil.copy(calibration_file, tmp_path / "cal.npz")
    said = run_json("force", "calibrate", loads, "-c", own)
    assert said["normal"]["weights"] == [[pytest.approx(K)]]
    assert said["unit"] == "N"
    assert gelform.load_calibration(own).force.normal.loads == said["normal"]["loads"]
    errors = run_json("force", "evaluate", loads, "-c", own)
    assert re.search(r"^force +\d loads up to", run("info", own)[1], re.M)
    assert errors["normal"][-1]["mae"] < 0.01 < errors["normal"][-1]["constant"]["mae"]
    code, out, err = run("force", "evaluate", loads, "-c", own)
    assert code == 0
    assert "constant" in out
    code, _, err = run("force", "calibrate", loads, "-c", own, "-o", tmp_path / "other.npz")
    assert code == 0
    assert f"normal: {said['normal']['loads']} loads" in err
    assert (tmp_path / "other.npz").is_file()


def test_what_is_refused_leaves_the_calibration(fails, loads, calibration_file, tmp_path):
    before = calibration_file.read_bytes()
    assert "gelform force calibrate" in fails("force", "evaluate", loads, "-c", calibration_file)
    light = tmp_path / "grams"
    shutil.copytree(loads, light)
    head, *rows = (
        (light / "loads.csv").read_text().split()[0],
        *(light / "loads.csv").read_text().splitlines()[1:],
    )
    rows = [
        f"{image},{name},{float(force) * 1000 / 9.80665}"
        for image, name, force in (r.split(",") for r in rows)
    ]
    (light / "loads.csv").write_text("\n".join([head, *rows, ""]))
    assert "grams" in fails("force", "calibrate", light, "-c", calibration_file)
    assert calibration_file.read_bytes() == before
