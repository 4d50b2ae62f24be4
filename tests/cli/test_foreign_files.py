"""Files of other programs, met by any command: the message has what to do with them."""

import numpy as np
import pytest

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
    run, calibration_file, press_folder, tmp_path, name, way
):
    path, out = tmp_path / name, tmp_path / "out"
    path.write_bytes(b"anything at all, long enough to be looked at")
    if name.endswith(".npz"):
        np.savez(path, frames=np.zeros((2, 4, 5, 3), np.uint8))
    for command in (
        ("info", path),
        ("reconstruct", path, "-c", calibration_file, "-o", out),
        ("batch", path, "-c", calibration_file, "-o", out),
        ("explain", path, "-c", calibration_file, "-o", out),
        ("calibrate", path, "-o", out),
        ("track", path, "-c", calibration_file, "-o", out),
        ("live", path, "-c", calibration_file),
        ("reconstruct", press_folder / "images" / "0000.png", "-c", path, "-o", out)
        if not name.endswith(".npz")
        else ("info", path),
    ):
        code, _, err = run(*command)
        assert code == 1, (command, err)
        assert way in " ".join(err.split()), command


def test_a_bag_of_sqlite3_has_the_converting_line_in_every_command(run, calibration_file, tmp_path):
    bag = tmp_path / "my_bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 9\n")
    (bag / "my_bag_0.db3").write_bytes(b"SQLite format 3")
    for command in (
        ("reconstruct", bag, "-c", calibration_file, "-o", tmp_path / "out"),
        ("batch", bag, "-c", calibration_file, "-o", tmp_path / "out"),
        ("calibrate", bag, "-o", tmp_path / "out"),
        ("track", bag, "-c", calibration_file, "-o", tmp_path / "out.csv"),
        ("live", bag, "-c", calibration_file),
        ("bag", bag, "-c", calibration_file, "-o", tmp_path / "out"),
    ):
        code, _, err = run(*command)
        assert code == 1, (command, err)
        assert BAG.format("my_bag", "my_bag") in " ".join(err.split()), command
    assert BAG.format("my_bag", "my_bag") in " ".join(run("info", bag)[1].split())
