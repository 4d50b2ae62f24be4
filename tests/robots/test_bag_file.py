"""A bag is complete or absent: interrupted, failing, killed, on a full disk."""

import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from gelform import DataError, Frame, Reconstruction, open_source
from gelform.errors import Finding
from gelform.robots.send import BagFile

Reader = pytest.importorskip("rosbags.rosbag2", reason="the extra ros is not installed").Reader
SHAPE, START_NS = (60, 80), 1_700_000_000_000_000_000


def frame_of(index=0):
    return Frame(np.full((*SHAPE, 3), index, np.uint8), index / 10, START_NS + index * 10**8, index)


def result_of():
    maps, yes = np.ones(SHAPE, np.float32), np.ones(SHAPE, bool)
    return Reconstruction(maps, None, np.zeros((*SHAPE, 2), np.float32), None, maps, yes, yes, 0.1)


def write(bag, count, result=None):
    for index in range(count):
        bag.write(frame_of(index), result or result_of(), START_NS + index * 10**8)


def test_it_has_its_name_only_when_it_is_whole(tmp_path):
    with BagFile(tmp_path / "bag", "left") as bag:
        write(bag, 2)
        assert not (tmp_path / "bag").exists()
    assert {path.name for path in tmp_path.rglob("*")} == {"bag", "bag.mcap", "metadata.yaml"}
    with pytest.raises(DataError, match="is there already"):
        BagFile(tmp_path / "bag", "left")


def test_rosbags_reads_metadata_counts_and_qos(tmp_path):
    with BagFile(tmp_path / "bag", "left") as bag:
        write(bag, 12)
    with Reader(tmp_path / "bag") as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        assert counts.pop("/diagnostics") == 2
        assert counts.pop("/left/wrench") == 0  # no known loads
        assert counts == {f"/left/{name}": 12 for name in ("image_raw", "indentation", "points")}
        for one in reader.connections:
            (qos,) = one.ext.offered_qos_profiles
            assert (qos.reliability.name, qos.durability.name, qos.depth) == ("RELIABLE", "VOLATILE", 10)
        assert reader.duration == 11 * 10**8 + 1  # rosbags counts the last nanosecond in


def test_diagnostics_come_once_a_second_and_at_each_change(tmp_path):
    torn = replace(result_of(), health=(Finding("torn", "Torn.", 0.5),))
    with BagFile(tmp_path / "bag", "left", topics=("image", "diagnostics")) as bag:
        write(bag, 25)
        for index in (25, 26):
            bag.write(frame_of(index), torn, START_NS + index * 10**8)
    with Reader(tmp_path / "bag") as reader:
        taken = [(t - START_NS) // 10**8 for one, t, _ in reader.messages() if one.topic == "/diagnostics"]
    assert taken == [0, 10, 20, 25]


def test_ctrl_c_keeps_what_was_written_and_an_error_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _write_and_raise(tmp_path / "kept", KeyboardInterrupt)
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    assert len(list(open_source(tmp_path / "kept"))) == 3
    with pytest.raises(RuntimeError):
        _write_and_raise(tmp_path / "lost", RuntimeError)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def _write_and_raise(path, problem):
    with BagFile(path, "left") as bag:
        write(bag, 3)
        raise problem


PROGRAM = f"""
import os, resource, signal, sys
sys.path[:0] = {[__file__.rsplit("/", 2)[0], __file__.rsplit("/", 1)[0]]!r}
from test_bag_file import BagFile, write
with BagFile(sys.argv[1], "left") as bag:
    if sys.argv[2] == "full":
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2 * 2**20, 2 * 2**20))
        write(bag, 60)
    write(bag, 30)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
@pytest.mark.parametrize("fault", ["killed", "full"])
def test_a_process_that_dies_leaves_no_bag_under_its_name(tmp_path, fault):
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "bag"), fault]
    run = subprocess.run(command, capture_output=True, text=True)
    left = [path.name for path in tmp_path.iterdir()]
    if fault == "killed":
        assert run.returncode == -signal.SIGKILL, run.stderr
        assert left == [f".bag.partial-{left[0].split('-')[1]}"]
    else:
        assert "DataError: Cannot write" in run.stderr, run.stderr
        assert "File too large. Nothing of it was kept." in run.stderr
        assert left == []
