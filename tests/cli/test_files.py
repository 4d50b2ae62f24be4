"""Output files of commands: names of results, folders, the files of a report.

Image files of a calibrated sensor: an error names the file.

Files of other programs, met by any command: the message has what to do with them.
"""

import errno
import os
import shutil
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform.calibration import report
from gelform.calibration_file import load_calibration
from gelform.cli import files as outputs
from gelform.cli.files import Inputs, check_output, check_results, new_pictures, result_paths
from gelform.errors import DataError
from gelform.exchange.plots import save_picture

part = st.sampled_from(["a", "b", "a.b", "gelsight", "ä ö", "0", "1"])
image = st.builds(
    lambda folders, stem, suffix: "/".join(["/data", *folders, stem + suffix]),
    st.lists(part, max_size=3),
    part,
    st.sampled_from([".png", ".jpg", ".PNG", ""]),
)


@given(st.lists(image, min_size=1, max_size=12, unique=True))
def test_names_are_never_shared_and_stay_in_the_folder(tmp_path_factory, inputs):
    folder = tmp_path_factory.getbasetemp() / "out"
    try:
        paths = result_paths([type(folder)(one) for one in inputs], folder, ("npz", "png"))
    except DataError:  # refused, which test_what_cannot_be_told_apart_is_refused looks at
        return
    results = [str(path) for one in paths for path in one.values()]
    assert len(set(results)) == 2 * len(inputs)
    assert all(os.path.commonpath([folder, one]) == str(folder) for one in results)


@pytest.mark.parametrize(
    ("inputs", "names"),
    [
        (["x/frame.png"], ["frame"]),
        (["9.5mm/0/gelsight.png", "9.5mm/1/gelsight.png"], ["0/gelsight", "1/gelsight"]),
        (["a/x.png", "b/c/x.png"], ["a/x", "b/c/x"]),
        (["a/x.png", "a/x.jpg", "a/y.png"], ["x.png", "x.jpg", "y"]),
        (["x.tar.png"], ["x.tar"]),
        (["../up/x.png", "y.png"], ["up/x", "here/y"]),
    ],
)
def test_a_result_lies_below_the_common_folder(tmp_path, monkeypatch, inputs, names):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    paths = result_paths([type(tmp_path)(one) for one in inputs], tmp_path / "out", ("npz",))
    assert [one["npz"].relative_to(tmp_path / "out").as_posix() for one in paths] == [
        f"{name}.npz" for name in names
    ]


def test_what_cannot_be_told_apart_is_refused(tmp_path):
    with pytest.raises(DataError, match="given twice"):
        result_paths([tmp_path / "a.png", tmp_path / "b" / ".." / "a.png"], tmp_path, ("npz",))
    with pytest.raises(DataError, match=r"both be called a\.png"):
        result_paths([tmp_path / "a.png", tmp_path / "a.jpg", tmp_path / "a.png.bmp"], tmp_path, ("npz",))


def test_results_that_are_there_and_inputs_are_protected(tmp_path):
    first, second, source = (tmp_path / name for name in ("0.npz", "1.npz", "image.png"))
    first.touch()
    second.touch()
    source.touch()
    with pytest.raises(DataError, match=r"0\.npz is already there and 1 more.*--overwrite"):
        check_results([first, second], overwrite=False, protected=[source])
    check_results([first, second], overwrite=True, protected=[source])
    for overwrite in (False, True):
        with pytest.raises(DataError, match="would replace an input"):
            check_results([tmp_path / "." / "image.png"], overwrite=overwrite, protected=[source])


def test_pictures_replace_neither_images_nor_calibrations(tmp_path):
    images = [tmp_path / "a.png", tmp_path / "b.png"]
    assert new_pictures(images, None, overwrite=False) == [(image, None) for image in images]
    out = tmp_path / "out"
    assert new_pictures(images, out, overwrite=False) == [(image, out / image.name) for image in images]
    for folder, read in ((tmp_path, [None]), (out, [None, out / "a.png"])):
        with pytest.raises(DataError, match="would replace an input"):
            new_pictures(images, folder, overwrite=True, read=read)


def test_an_output_is_checked_before_the_work(tmp_path):
    (tmp_path / "there").touch()
    with pytest.raises(DataError, match="got the folder"):
        check_output(tmp_path, overwrite=True)
    with pytest.raises(DataError, match=r"already there.*--overwrite"):
        check_output(tmp_path / "there", overwrite=False)
    with pytest.raises(DataError, match="Expected a folder to write to, got the file"):
        check_output(tmp_path / "there" / "x", overwrite=False)
    with pytest.raises(DataError, match="Cannot make the folder"):
        check_output(tmp_path / "there" / "below" / "x", overwrite=False)
    check_output(tmp_path / "there", overwrite=True)
    check_output(tmp_path / "a" / "b", overwrite=False)
    assert (tmp_path / "a").is_dir()


def test_a_full_disk_leaves_none_of_them(tmp_path, monkeypatch):
    """The disk is full when the second file is brought to it: the first must not stay."""
    calls = []

    def full(handle):
        calls.append(handle)
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(report, "report_page", lambda *_: "page")
    made = SimpleNamespace(report=SimpleNamespace(presses=[]))
    write = partial(outputs.write_report, {}, None, made, tmp_path, False)
    with monkeypatch.context() as patched:
        patched.setattr(outputs.os, "fsync", full)
        with pytest.raises(DataError, match="No space left"):
            write()
    assert list(tmp_path.iterdir()) == []
    write()
    assert {path.name for path in tmp_path.iterdir()} == set(outputs.REPORT_FILES)


def test_another_size_names_the_file(calibration_file, tmp_path):
    calibration = load_calibration(calibration_file)
    save_picture(tmp_path / "small.png", np.zeros((60, 80, 3), dtype=np.uint8))
    small = tmp_path / "small.png"
    for read in (partial(Inputs().image, small), Inputs(background=small).background_for):
        with pytest.raises(DataError, match=r"small\.png, for .*120x160.*60x80\. Use the calibration of"):
            read(calibration)


BAG = "rosbags-convert --src {} --dst {}_mcap --dst-storage mcap"


@pytest.mark.parametrize(
    ("name", "way"),
    [
        ("frames.npz", 'numpy.load("frames.npz")'),
        ("frames.pkl", "Reading one can run code"),
        ("frames.zip", "Unpack it"),
        ("net.pth", "gelform import net.pth --from gs_sdk"),
        ("table.mat", "gelform import table.mat --from lut"),
        ("scan.tmd", "nothing to reconstruct"),
        ("session.bag", BAG.format("session.bag", "session")),
        ("session_0.db3", BAG.format("FOLDER", "session_0")),
    ],
)
def test_every_command_that_meets_one_says_what_to_do(
    fails, calibration_file, press_folder, tmp_path, name, way
):
    path, out = tmp_path / name, tmp_path / "out"
    path.write_bytes(b"anything at all, long enough to be looked at")
    if name.endswith(".npz"):
        np.savez(path, frames=np.zeros((2, 4, 5, 3), np.uint8))
    mine, to = ("-c", calibration_file), ("-o", out)
    reading = [(name, path, *mine, *to) for name in ("reconstruct", "batch", "explain", "track")]
    for command in (*reading, ("info", path), ("calibrate", path, *to), ("live", path, *mine)):
        assert way in fails(*command), command
    if not name.endswith(".npz"):
        assert way in fails("reconstruct", press_folder / "images" / "0000.png", "-c", path, *to)


def test_a_bag_of_sqlite3_has_the_converting_line_in_every_command(works, fails, calibration_file, tmp_path):
    bag = tmp_path / "my_bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    (bag / "my_bag_0.db3").write_bytes(b"SQLite format 3")
    out, way = tmp_path / "out.csv", BAG.format("my_bag", "my_bag")
    for command in ("reconstruct", "batch", "track", "bag", "live"):
        to = () if command == "live" else ("-o", out if command == "track" else tmp_path / "out")
        assert way in fails(command, bag, "-c", calibration_file, *to), command
    assert way in fails("calibrate", bag, "-o", out)
    assert way in " ".join(works("info", bag)[0].split())


@pytest.fixture(scope="session")
def in_bgr(press_folder, tmp_path_factory):
    """The press folder with loads of its volumes; the same with the colors in OpenCV's order, and one array of them."""
    right, turned = (tmp_path_factory.mktemp("colors") / name for name in ("rgb", "bgr"))
    shutil.copytree(press_folder, right)
    lines = ["image,object,force_n"]
    for path in sorted((right / "truth").glob("*.npz")):
        with np.load(path) as truth:
            lines.append(f"images/{path.stem}.png,ball,{truth['depth_mm'][truth['contact']].sum() / 1250}")
    (right / "loads.csv").write_text("\n".join([*lines, ""]))
    shutil.copytree(right, turned)
    for path in turned.rglob("*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path))[..., ::-1])
    np.save(right / "1.npy", cv2.imread(str(turned / "images" / "0001.png")))
    np.save(turned / "1.npy", cv2.imread(str(right / "images" / "0001.png")))
    return right, turned


@pytest.mark.parametrize(
    ("command", "key"),
    [
        ("calibrate {} -o {out} --model polynomial", ["held_out"]),
        ("evaluate {} -c {cal}", []),  # which knows again the presses that it has seen
        ("force calibrate {} -c {cal} -o {out} --sure-of-unit", ["normal"]),
        ("compare {}/1.npy -c {cal} -c {cal}", ["images", 0, "peak_a"]),
        ("explain {}/1.npy -c {cal}", ["images", 0, "trusted_share"]),
        ("reconstruct {}/1.npy -c {cal} -o {out}", ["results", 0, "peak_mm"]),
        ("batch {}/images -c {cal} -o {out}", ["tally"]),
        ("bag {}/images -c {cal} -o {out}", ["tally"]),
    ],
)
def test_colors_as_opencv_has_them_give_the_same_numbers(
    run_json, in_bgr, calibration_file, tmp_path, command, key
):
    said = []
    for number, (folder, more) in enumerate(zip(in_bgr, ((), ("--bgr",)))):
        out = tmp_path / (f"{number}.npz" if "calibrate" in command else f"{number}")
        words = command.format(folder, cal=calibration_file, out=out).split()
        said.append(run_json(*words, *more))
        for part in key:
            said[-1] = said[-1][part]
    assert said[0] == said[1]


def test_colors_in_the_other_order_name_the_option(fails, in_bgr, calibration_file):
    for command, path in (("evaluate", in_bgr[1]), ("explain", in_bgr[1] / "images" / "0001.png")):
        assert "--bgr" in fails(command, path, "-c", calibration_file)
