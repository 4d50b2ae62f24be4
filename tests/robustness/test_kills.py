"""Killed at any moment, or on a full disk: what is under its name is whole, and what was there stays.

`GELFORM_ROBUSTNESS_FACTOR=5` asks for the 20 kills of each command that the guarantees speak of.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

import gelform
from gelform.cli import main
from hostile.budget import FACTOR
from hostile.small_gel import MM_PER_PX, Touch, background, calibration, image_of
from made.torch_file_writer import network_arrays, torch_file

PLACES = [(x, y) for y in (20, 32, 44) for x in (20, 40, 60)]
COMMANDS = ("calibrate", "import", "reconstruct", "simulate")
KILLS = 3 if FACTOR < 5 else 20
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A calibration, images, a background, another package's network."""
    folder = tmp_path_factory.mktemp("work")
    calibration().save(folder / "cal.npz")
    for k in range(3):
        save(folder / f"image{k}.png", image_of(Touch(seed=k)))
    save(folder / "rest.png", np.rint(background()).astype(np.uint8))
    torch_file(folder / "net.pth", network_arrays((5, 32, 32, 32, 2)))
    touches = [Touch(x_px=x, y_px=y, depth_mm=0.35, seed=k) for k, (x, y) in enumerate(PLACES)]
    gelform.save_press_folder(
        folder / "presses",
        background=image_of(None),
        images=[image_of(touch) for touch in touches],
        ball_diameters_mm=[8.0] * len(touches),
        mm_per_px=MM_PER_PX,
        name="known gel",
    )
    return folder


def save(path, image):
    import cv2

    path.write_bytes(cv2.imencode(".png", image[..., ::-1])[1].tobytes())


def commands(work, out):
    """Each command that writes, with its output below `out`."""
    images = [work / f"image{k}.png" for k in range(3)]
    imported = ["--from", "gs_sdk", "--background", work / "rest.png", "--mm-per-px", "0.1"]
    fitted = ["--model", "polynomial", "--report", out / "report"]
    return {
        "calibrate": ["calibrate", work / "presses", *fitted, "-o", out / "cal.npz"],
        "reconstruct": ["reconstruct", *images, "-c", work / "cal.npz", "-o", out / "results"],
        "simulate": ["simulate", "-o", out / "set", "--count", "2", "--sensor", "three-edges"],
        "import": ["import", work / "net.pth", *imported, "-o", out / "imported.npz"],
    }


def start(arguments, before=lambda: None):
    """The command in a forked process, which says nothing."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        before()
        main([str(one) for one in arguments])
    except SystemExit as stopped:
        status = stopped.code or 0
    finally:
        os._exit(status if isinstance(status, int) else 70)


def assert_whole(out):
    """Every file under a name of its own can be read; what is half-written, or beside half-written, has a hidden one."""
    for path in sorted(out.rglob("*")):
        if any(part.startswith(".") for part in path.relative_to(out).parts):
            continue
        if path.suffix == ".png":
            gelform.read_image(path)
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                assert [file[name].shape for name in file.files]  # each read to its end
            if "truth" not in path.parts:
                (gelform.load_result if path.parent.name == "results" else gelform.load_calibration)(path)


@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_random_moments(work, tmp_path, name):
    rng = np.random.default_rng(11)
    begin = time.monotonic()
    assert os.waitpid(start(commands(work, tmp_path / "whole")[name], (tmp_path / "whole").mkdir), 0)[1] == 0
    usual = time.monotonic() - begin
    for kill in range(KILLS):
        out = tmp_path / f"killed{kill}"
        out.mkdir()
        child = start(commands(work, out)[name])
        time.sleep(rng.uniform(0, usual))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert_whole(out)


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("there_before", [False, True])
def test_killed_at_each_step_of_writing(work, tmp_path, step, there_before):
    """The old file or nothing: never half of the new one."""
    target = tmp_path / "imported.npz"
    arguments = commands(work, tmp_path)["import"]
    if there_before:
        assert os.waitpid(start(arguments), 0)[1] == 0
        before = target.read_bytes()
        arguments = [*arguments, "--overwrite"]

    def kill_there():
        setattr(os, step, lambda *_: os.kill(os.getpid(), signal.SIGKILL))

    _, status = os.waitpid(start(arguments, kill_there), 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert (target.read_bytes() == before) if there_before else not target.exists()
    assert os.waitpid(start(arguments), 0)[1] == 0  # what is left over is in nobody's way
    gelform.load_calibration(target)


@contextmanager
def full_disk(folder, kilobytes):
    """A file system of 1 MB, filled but for so many kilobytes."""
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder], capture_output=True)
    if mounted.returncode:
        pytest.skip(f"cannot mount a small file system here: {mounted.stderr.decode().strip()}")
    try:
        (folder / "filler").write_bytes(bytes((1024 - kilobytes) * 1024))
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("kilobytes", [0, 24])
def test_a_full_disk_is_one_sentence_and_nothing_stays(work, tmp_path, capfd, name, kilobytes):
    disk = tmp_path / "disk"
    with full_disk(disk, kilobytes):
        with pytest.raises(SystemExit) as stopped:
            main([str(one) for one in commands(work, disk)[name]])
        said = capfd.readouterr().err
        files = [path for path in disk.rglob("*") if path.is_file() and path.name != "filler"]
    assert stopped.value.code == 1
    assert "Traceback" not in said
    assert "No space left on device" in said
    assert not [path for path in files if path.name.startswith(".") or path.suffix in (".tmp", ".partial")]
