"""gelform force calibrate and evaluate: what they write and print, and what they refuse."""

import re
import shutil
from pathlib import Path

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


def test_loads_of_blue_green_red_give_the_same_forces_with_bgr(run_json, loads, calibration_file, tmp_path):
    turned = Path(shutil.copytree(loads, tmp_path / "turned"))
    for path in turned.glob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path))[..., ::-1])
    right, found = (
        run_json(
            "force", "calibrate", folder, "-c", calibration_file, "-o", tmp_path / f"{folder.name}.npz", *more
        )
        for folder, more in ((loads, ()), (turned, ("--bgr",)))
    )
    assert found["normal"] == right["normal"]


def test_loads_are_added_to_the_calibration_and_measured(
    run, run_json, fails, loads, calibration_file, tmp_path
):
    own = Path(shutil.copy(calibration_file, tmp_path / "cal.npz"))
    before = own.read_bytes()
    assert "is already there" in fails("force", "calibrate", loads, "-c", own)
    assert own.read_bytes() == before
    said = run_json("force", "calibrate", loads, "-c", own, "--overwrite")
    assert said["normal"]["weights"] == [[pytest.approx(K)]]
    assert said["unit"] == "N"
    assert gelform.load_calibration(own).force.normal.loads == said["normal"]["loads"]
    errors = run_json("force", "evaluate", loads, "-c", own)
    assert re.search(r"^force +\d loads up to", run("info", own)[1], re.M)
    assert errors["normal"][-1]["mae"] < 0.01 < errors["normal"][-1]["constant"]["mae"]
    code, out, err = run("force", "evaluate", loads, "-c", own)
    assert code == 0
    assert "constant's (N)" in " ".join(out.split())
    assert out.count("(%)") == 5
    whole = next(line.split() for line in out.splitlines() if line.split()[:1] == ["all"])
    assert float(whole[2]) == 100 * errors["normal"][-1]["refused"]
    assert float(whole[-1]) == 100 * errors["normal"][-1]["within_2"]
    assert re.search(
        r"Errors of the normal force are [\d.e-]+ times the stated sigma\.", " ".join(err.split())
    )
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
    assert "grams" in fails("force", "calibrate", light, "-c", calibration_file, "--overwrite")
    assert calibration_file.read_bytes() == before


def test_the_lag_is_stored_and_its_range_s_end_is_a_warning(run, run_json, loads, calibration_file, tmp_path):
    """Loads that come four frames too early, which is beyond the range; evaluate takes the stored lag as it is."""
    rows = [line.split(",") for line in (loads / "loads.csv").read_text().splitlines()[1:]]
    names, force = [row[0] for row in rows], [float(row[2]) for row in rows]
    order = sorted(range(len(rows)), key=lambda k: force[k])
    ramp = [*order, *order[::-1]]
    film = tmp_path / "film"
    shutil.copytree(loads, film)
    lines = ["image,object,grasp,frame,force_n"]
    for frame, k in enumerate(ramp):
        early = force[ramp[min(frame + 4, len(ramp) - 1)]]
        lines.append(f"{names[k]},ball,0,{frame},{early}")
    (film / "loads.csv").write_text("\n".join([*lines, ""]))
    own = tmp_path / "cal.npz"
    code, _, err = run("force", "calibrate", film, "-c", calibration_file, "-o", own)
    assert code == 0
    assert "a lag of -3 frames is at the end of the range" in " ".join(err.split())
    assert gelform.load_calibration(own).force.lag_frames == -3
    still = film / "loads.csv"
    still.write_text(
        "\n".join([lines[0], *(f"{names[k]},ball,0,{f},{force[k]}" for f, k in enumerate(ramp)), ""])
    )
    assert run_json("force", "evaluate", film, "-c", own)["lag_frames"] == -3
