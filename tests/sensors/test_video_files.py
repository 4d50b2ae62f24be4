"""Video files whose name OpenCV cannot take."""

import os

import cv2
import numpy as np
import pytest

from gelform.cli import main
from gelform.errors import DataError
from gelform.sensors.recordings.indexed import indexed
from gelform.sensors.source import open_source
from gelform.sensors.video_files import Video


@pytest.fixture
def odd_name(tmp_path):
    """A video that can be decoded, under a name of bytes that are no UTF-8."""
    path = tmp_path / "presses.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (80, 64))
    for _ in range(3):
        writer.write(np.full((64, 80, 3), 100, np.uint8))
    writer.release()
    assert len(list(Video(path))) == 3
    odd = tmp_path / os.fsdecode(b"presses \xff.avi")
    try:
        return path.rename(odd)
    except OSError:
        pytest.skip("this file system has names in UTF-8 alone")


def test_a_name_that_is_no_utf_8_is_refused_by_every_reader(odd_name):
    for reader in (Video, open_source, indexed):
        with pytest.raises(DataError, match=r"udcff.avi' is no UTF-8. Rename it"):
            reader(odd_name)


def test_commands_say_so(odd_name, calibration, tmp_path, capsys):
    calibration.save(tmp_path / "cal.npz")
    after = ["-c", str(tmp_path / "cal.npz"), "-o", str(tmp_path / "out")]
    for command in (
        ["info", str(odd_name)],
        ["reconstruct", str(odd_name), *after],
        ["batch", str(odd_name), *after, "--table", "csv"],
    ):
        with pytest.raises(SystemExit, match=r"^1$"):
            main(command)
    assert "no UTF-8. Rename it" in capsys.readouterr().err
    assert "no UTF-8. Rename it" in (tmp_path / "out" / "frames.csv").read_text()
