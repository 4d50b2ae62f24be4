"""gelform evaluate, compare, explain and measure."""

import csv
import shutil
from dataclasses import asdict

import numpy as np
import pytest

import gelform
from gelform.calibration.fit import evaluate
from gelform.calibration.presses.folder import read_presses
from gelform.calibration_file import load_calibration
from gelform.cli.commands import inspection
from gelform.exchange import plots
from gelform.exchange.plots import save_picture


def test_errors_and_what_was_seen(works, run_json, press_folder, calibration_file):
    said = run_json("evaluate", press_folder, "-c", calibration_file)
    expected = evaluate(load_calibration(calibration_file), read_presses(press_folder))
    assert said["summary"] == expected.summary
    assert said["seen"] == expected.seen > 0
    assert said["where"] == expected.where
    out, err = works("evaluate", press_folder, "-c", calibration_file)
    assert f"made from {expected.seen} of these presses" in err
    assert out.count("(used)") == expected.seen
    assert "may even be larger" in err
    assert "by the ball's slope" in out
    assert f"{expected.where['contact']['by_slope'][0]['normal_deg']:.3g}" in out
    assert f"{expected.where['rim']['by_slope'][0]['normal_deg']:.3g}" in out
    words = " ".join(out.split())
    assert f"edge at {expected.where['contact_radius_ratio']:.2f} of the visible radius" in words
    assert "up to the rim" in words
    degrees = load_calibration(calibration_file).held_out["normal_free_deg"]
    assert f"at calibration ({degrees:.2g}°)." in err
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80


def test_evaluate_ends_with_what_the_errors_mean():
    then = {"normal_free_deg": 2.3}
    for now, said in (
        (2.3, "off by 2.3°: as at calibration (2.3°)."),
        (1.2, "off by 1.2°: less than at calibration (2.3°)."),
        (4.6, "off by 4.6°: 2 times as much as at calibration (2.3°). Check that"),
    ):
        assert said in inspection.verdict_of({"normal_free_deg": now}, then)
    assert "states no errors of its own" in inspection.verdict_of(then, {})


def test_folders_are_their_images_and_a_calibration_agrees_with_itself(
    run_json, fails, press_folder, calibration_file, tmp_path
):
    folder, mine = press_folder / "images", ("-c", calibration_file)
    background = ("--background", press_folder / "background.png")
    compared = run_json("compare", folder, *mine, *mine)["images"]
    assert [row["image"] for row in compared] == [str(path) for path in sorted(folder.iterdir())]
    explained = run_json("explain", folder, *mine, *background)["images"]
    assert len(explained) == len(compared)
    for row in compared:
        assert (row["unit"], row["difference_rms"], row["angle_deg"]) == ("mm", 0, 0)
        assert row["peak_a"] == row["peak_b"] > 0
    np.save(tmp_path / "stack.npy", np.zeros((2, 120, 160, 3), np.uint8))
    for command in (("compare", *mine, *mine), ("explain", *mine)):
        assert "Its frames: gelform batch" in fails(command[0], tmp_path / "stack.npy", *command[1:])


def test_heights_of_flat_punches_are_shown(works, press_folder, calibration_file, tmp_path):
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
    out = works("evaluate", copy, "-c", calibration_file)[0]
    shown = next(line for line in out.split("Flat punches")[1].splitlines() if row["image"] in line)
    assert " 0.5 " in shown
    assert max(len(line.rstrip()) for line in out.splitlines()) <= 80


def images_of(press_folder):
    return [press_folder / "images" / f"000{k}.png" for k in (1, 4)]


@pytest.mark.slow
def test_compare_writes_a_picture_for_each_image(
    works, run_json, imported, calibration_file, press_folder, tmp_path, monkeypatch
):
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    images, folder, drawn = images_of(press_folder), tmp_path / "side", []
    draw = plots.comparison_picture

    def noted(a, b, image, *, names):
        drawn.append((a.mm_per_px, b.mm_per_px, *names))
        return draw(a, b, image, names=names)

    monkeypatch.setattr(plots, "comparison_picture", noted)
    said = run_json("compare", *images, "-c", calibration_file, "-c", imported, "-o", folder)
    scale = load_calibration(calibration_file).mm_per_px
    assert drawn == [(scale, None, calibration_file.stem, "imported")] * 2
    assert [row["image"] for row in said["images"]] == [str(image) for image in images]
    for image, row in zip(images, said["images"]):
        assert gelform.read_image(folder / f"{image.stem}.png").shape[2] == 3
        assert row["unit"] == "px"
        assert row["peak_a"] > 0
    out = works("compare", images[0], "-c", calibration_file, "-c", calibration_file)[0]
    assert "peak A (mm)" in out


@pytest.mark.slow
def test_explain_names_causes_and_draws_them(works, run_json, calibration_file, press_folder, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    clean, spotted = press_folder / "images" / "0001.png", tmp_path / "spotted.png"
    image = gelform.read_image(clean).copy()
    image[20:40, 30:55] = 255  # a burnt-out spot
    save_picture(spotted, image)
    rows = run_json("explain", clean, spotted, "-c", calibration_file, "-o", tmp_path / "why")["images"]
    assert [row["image"] for row in rows] == [str(clean), str(spotted)]
    for row in rows:
        assert sum(row["variance_shares"].values()) == pytest.approx(1)
        assert gelform.read_image(row["picture"]).shape[2] == 3
    found = [{finding["name"]: finding["figure"] for finding in row["findings"]} for row in rows]
    assert "saturated" not in found[0]
    assert found[1]["saturated"] == pytest.approx(20 * 25 / (120 * 160), rel=0.6)
    out, said = works("explain", spotted, "-c", calibration_file)
    assert "saturated (%)" in out
    assert "of the frame is at the camera's upper end. Lower exposure" in said


@pytest.fixture(scope="session")
def measured_results(calibration_file, press_folder, tmp_path_factory):
    """Two saved results in a folder."""
    folder = tmp_path_factory.mktemp("results")
    reconstruct = gelform.Reconstructor(load_calibration(calibration_file))
    for image in images_of(press_folder):
        gelform.save_result(reconstruct(gelform.read_image(image)), folder / f"{image.stem}.npz")
    return folder


ASKED = ("--line", "50,60,110,60", "--region", "60,45,80,75", "--region", "90,45,110,75", "--radius", "ball")


def test_measure_says_and_writes_what_the_function_does(works, run_json, measured_results, tmp_path):
    table = tmp_path / "figures.csv"
    rows = run_json("measure", measured_results, *ASKED, "--csv", table)["results"]
    written = list(csv.DictReader(table.read_text().splitlines()))
    paths = sorted(measured_results.iterdir())
    assert [row["result"] for row in rows] == [str(path) for path in paths]
    for path, row in zip(paths, rows):
        wanted = gelform.measure(
            gelform.load_result(path),
            lines=[(50, 60, 110, 60)],
            regions=[(60, 45, 80, 75), (90, 45, 110, 75)],
            radius="ball",
        ).quantities
        assert row["figures"] == [{**asdict(one), "doubts": list(one.doubts)} for one in wanted]
        of_file = [one for one in written if one["result"] == str(path)]
        assert [(one["of"], one["name"]) for one in of_file] == [(one.of, one.name) for one in wanted]
        for one, by in zip(of_file, wanted):
            assert (float(one["value"]) if one["value"] else None) == by.value
            assert (float(one["sigma"]) if one["sigma"] else None) == by.sigma
    out, err = works("measure", paths[0], *ASKED)
    assert "region 2 - region 1" in out
    assert "±" in out
    assert f"line 1, {wanted[2].name}: " in err or not wanted[2].doubts


@pytest.mark.slow
def test_measure_draws_lines_and_regions(run_json, measured_results, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    rows = run_json("measure", measured_results, *ASKED, "--line", "40,30,120,90", "-o", tmp_path / "drawn")[
        "results"
    ]
    for row in rows:
        assert gelform.read_image(row["picture"]).shape[2] == 3
    bare = run_json("measure", measured_results, "-o", tmp_path / "contact")["results"]
    assert {one["of"] for one in bare[0]["figures"]} == {"contact"}


def test_measure_refuses_in_words(fails, measured_results, calibration_file, tmp_path):
    result = sorted(measured_results.iterdir())[0]
    assert "in pixels of the image, 0-159 and 0-119" in fails("measure", result, "--line", "1,2,300,4")
    assert "expected X1,Y1,X2,Y2" in fails("measure", result, "--region", "1,2,3", status=2)
    assert "expected ball or cylinder" in fails("measure", result, "--radius", "cone", status=2)
    assert "found none" in fails("measure", tmp_path)
    assert "result" in fails("measure", calibration_file)
