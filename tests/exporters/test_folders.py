"""A folder is written whole or not at all; what is written is read back."""

import sys

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.exporters.folders import write_csv, write_png, write_sensor_toml, written_whole

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def test_a_folder_that_holds_something_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(DataError, match="new or empty folder"), written_whole(tmp_path):
        pass
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_a_folder_that_cannot_be_written_is_a_data_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="Cannot write"), written_whole(tmp_path / "file" / "out"):
        pass


def test_a_failure_leaves_nothing_and_success_the_whole(tmp_path):
    def fail_halfway():
        with written_whole(tmp_path / "out") as partial:
            (partial / "first").write_text("1")
            raise RuntimeError("halfway")

    with pytest.raises(RuntimeError, match="halfway"):
        fail_halfway()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").mkdir()  # an empty one may be there
    with written_whole(tmp_path / "out") as partial:
        (partial / "first").write_text("1")
        assert not (tmp_path / "out/first").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out/first").read_text() == "1"


def test_images_are_written_in_rgb_and_rounded(tmp_path):
    image = np.zeros((3, 4, 3))
    image[..., 0] = 200.6
    write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], np.rint(image))
    with pytest.raises(ValueError, match=r"a\.png"):
        write_png(tmp_path / "a.png", image, (4, 4))


def test_sensor_toml_holds_any_name(tmp_path):
    name = 'a "quoted" \\ name\nin two lines'
    write_sensor_toml(tmp_path / "sensor.toml", name, np.float64(0.3))
    assert tomllib.loads((tmp_path / "sensor.toml").read_text()) == {"name": name, "mm_per_px": 0.3}


def test_tables_have_the_header_of_their_rows(tmp_path):
    write_csv(tmp_path / "t.csv", [{"a": "1", "b": "2"}, {"a": "3", "b": "4"}])
    assert (tmp_path / "t.csv").read_text() == "a,b\n1,2\n3,4\n"
