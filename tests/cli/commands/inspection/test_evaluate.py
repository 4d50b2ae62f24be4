"""gelform evaluate: the same figures as the library's, and which presses were seen."""

import shutil

from gelform.calibration.evaluate import evaluate
from gelform.calibration.presses.folder import read_presses
from gelform.calibration_file import load_calibration


def test_errors_and_what_was_seen(run, run_json, press_folder, calibration_file):
    said = run_json("evaluate", press_folder, "-c", calibration_file)
    expected = evaluate(load_calibration(calibration_file), read_presses(press_folder))
    assert said["summary"] == expected.summary
    assert said["seen"] == expected.seen > 0
    assert said["where"] == expected.where
    code, out, err = run("evaluate", press_folder, "-c", calibration_file)
    assert code == 0
    assert f"made from {expected.seen} of these presses" in err
    assert out.count("(seen)") == expected.seen
    assert "may even be larger" in err
    assert "by the ball's slope" in out
    assert f"{expected.where['contact']['by_slope'][0]['normal_deg']:.3g}" in out
    assert f"{expected.where['rim']['by_slope'][0]['normal_deg']:.3g}" in out
    assert f"edge at {expected.where['contact_radius_ratio']:.2f} of the visible radius" in " ".join(
        out.split()
    )
    assert "up to the rim" in " ".join(out.split())
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80


def test_presses_of_another_size(fails, press_folder, calibration_file, tmp_path):
    import numpy as np

    from gelform.plots.canvas import save_picture

    grey = np.full((60, 80, 3), 90, dtype=np.uint8)
    save_picture(tmp_path / "background.png", grey)
    save_picture(tmp_path / "a.png", grey)
    arguments = (
        "evaluate",
        tmp_path,
        "-c",
        calibration_file,
        "--ball-diameter-mm",
        "6",
        "--mm-per-px",
        "0.1",
    )
    said = fails(*arguments)
    assert "Expected images of 120x160 px (height x width), got 60x80" in said


def test_a_wrong_calibration(fails, press_folder, tmp_path):
    assert "No file" in fails("evaluate", press_folder, "-c", tmp_path / "missing.npz")


def test_heights_of_flat_punches_are_shown(run, press_folder, calibration_file, tmp_path):
    """The table, not the heights: the press that is listed as that of a punch is one of a ball."""
    copy = shutil.copytree(press_folder, tmp_path / "copy")
    header, first, *others = (copy / "presses.csv").read_text().splitlines()
    columns, cells = header.split(","), first.split(",")
    row = {"image": cells[columns.index("image")], "indenter": "flat", "height_mm": "0.5"}
    names = [*columns, "indenter", "height_mm"]
    lines = [
        ",".join(names),
        ",".join(row.get(name, "") for name in names),
        *(line + ",," for line in others),
    ]
    (copy / "presses.csv").write_text("\n".join(lines) + "\n")
    code, out, _ = run("evaluate", copy, "-c", calibration_file)
    assert code == 0
    shown = next(line for line in out.split("Flat punches")[1].splitlines() if row["image"] in line)
    assert " 0.5 " in shown
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80
