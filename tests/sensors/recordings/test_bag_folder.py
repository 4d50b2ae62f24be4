"""Folders of rosbag2: known by their metadata; the file inside, or what to do where there is not one."""

import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.bag_folder import is_bag_folder, mcap_file_in


def folder(path, *names, metadata="rosbag2_bagfile_information:\n  version: 9\n"):
    path.mkdir()
    (path / "metadata.yaml").write_text(metadata)
    for name in names:
        (path / name).write_bytes(b"")
    return path


def test_a_folder_is_known_by_its_metadata(tmp_path):
    assert is_bag_folder(folder(tmp_path / "a", "a_0.mcap"))
    assert not is_bag_folder(folder(tmp_path / "b", "a_0.mcap", metadata="name: other\n"))
    assert not is_bag_folder(tmp_path)


def test_the_file_inside(tmp_path):
    assert mcap_file_in(folder(tmp_path / "a", "a_0.mcap")) == tmp_path / "a" / "a_0.mcap"


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("a_0.mcap", "a_1.mcap"), "got 2 in .* such as .*a_0.mcap"),
        (("a_0.db3",), "rosbags-convert --src bag --dst bag_mcap --dst-storage mcap"),
        (("a_0.mcap.zstd",), "zstd -d a_0.mcap.zstd -o bag.mcap"),
        ((), "Copy the whole folder"),
    ],
)
def test_what_to_do_where_there_is_not_one(tmp_path, names, said):
    with pytest.raises(DataError, match=said):
        mcap_file_in(folder(tmp_path / "bag", *names))
