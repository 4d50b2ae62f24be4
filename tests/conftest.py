"""Shared, simulated once per run: a sensor, its press folder, a calibration, recordings; and where the real data is."""

from __future__ import annotations

import inspect
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.exchange.exporters.press_folder import save_press_folder
from gelform.image.view import Frame
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Pose,
    SimulatedPress,
    SimulatedPresses,
    SimulatedSensor,
    simulate_ball_presses,
    simulate_pose,
    simulate_press,
)
from kernel_agreement import usable_isas
from made.files import EPISODES, write_lerobot_set
from made.small_gel import Touch, image_of
from made.sources import video_file
from made_once import MadeOnce

DATA = Path(os.environ.get("GELFORM_DATA", Path(__file__).parents[2] / "shared" / "data"))


# Files and folders that take longest: begun first, so that no worker is left with one of them while the others are done.
LONGEST = (
    "test_examples.py",
    "calibration/test_fit.py",
    "exchange/exporters/test_surface.py",
    "cli/test_console.py",
    "live/page/",
    "robustness/",
    "calibration/",
    "cli/",
    "sensors/streams/",
    "live/",
)


def pytest_configure(config):
    """Without the slow tests, a tenth of the hostile cases is tried (`hostile/outcome.py`).

    A shell's job in the background ignores Ctrl-C, one below nohup the end of its terminal, and so would every command that
    a test starts and interrupts.
    """
    if config.option.markexpr == "not slow":
        os.environ.setdefault("GELFORM_ROBUSTNESS_FACTOR", "0.1")
    for name, usual in (("SIGINT", signal.default_int_handler), ("SIGHUP", signal.SIG_DFL)):
        kind = getattr(signal, name, None)
        if kind is not None and signal.getsignal(kind) is signal.SIG_IGN:
            signal.signal(kind, usual)


def pytest_collection_modifyitems(items):
    """The files that take longest first; the order is else as it was.

    For the sanitizers' slow kernels only tests that call a kernel themselves are kept: whole frames call no other ones.
    """
    if "GELFORM_KERNELS_ALONE" in os.environ:
        own = ("tests/_native/", "tests/depth/solvers/test_weighted.py")
        items[:] = [
            item
            for item in items
            if item.nodeid.startswith(own) or "assert_kernel_agrees" in inspect.getsource(item.function)
        ]

    def rank(item):
        path = item.nodeid.removeprefix("tests/")
        return next((k for k, name in enumerate(LONGEST) if path.startswith(name)), len(LONGEST))

    items.sort(key=rank)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file's tests go to one worker: what they share within the file is made once."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # not by their number: what takes long is few tests
    return LoadFileScheduling(config, log)


@pytest.fixture(scope="session")
def made_once(request, tmp_path_factory) -> MadeOnce:
    """Makes what takes seconds once per run."""
    base = tmp_path_factory.getbasetemp()
    return MadeOnce(base.parent if hasattr(request.config, "workerinput") else base)


@pytest.fixture(scope="session", autouse=True)
def _no_library_of_the_user_s(tmp_path_factory):
    """No test looks into the library of calibrations or the cache of whoever runs it, nor writes there."""
    os.environ["GELFORM_CALIBRATIONS"] = str(tmp_path_factory.mktemp("no-library"))
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("no-cache"))


@pytest.fixture
def library(tmp_path, monkeypatch) -> Path:
    """An empty library of calibrations of the test's own."""
    folder = tmp_path / "library"
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(folder))
    return folder


@pytest.fixture(scope="session")
def playwright():
    """Drives browsers; one for all tests of a process, which allows no second."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="no Playwright: pip install playwright")
    with sync_api.sync_playwright() as running:
        yield running


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real sensor data; tests that ask for it are skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no real sensor data in {DATA}: set GELFORM_DATA")
    return DATA


@pytest.fixture(scope="session")
def sensor() -> SimulatedSensor:
    """Three near lights, half the usual size: quick to simulate."""
    return replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)


@pytest.fixture(scope="session")
def simulated(sensor, made_once) -> SimulatedPresses:
    """Presses of two balls all over the gel, some cut by the border."""
    rng = np.random.default_rng(3)
    return made_once(
        "simulated", lambda _: simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=14, rng=rng)
    )


@pytest.fixture(scope="session")
def unpressed(made_once) -> dict[float, list[np.ndarray]]:
    """Images of a unit of simulated-three-edges that made no starter: at rest, and pressed 0.4 mm deep by a ball."""
    rng, layout = np.random.default_rng(40), LAYOUTS["three-edges"]

    def image(depth_mm):
        return simulate_pose(layout, Ball(2.5), Pose(depth_mm), rng=rng, oversample=1).image

    return made_once("unpressed", lambda _: {mm: [image(mm) for _ in range(4)] for mm in (0.0, 0.4)})


@pytest.fixture(scope="session")
def folder(simulated, made_once) -> Path:
    """The same as a press folder on disk, without labels: nothing to peek at."""
    content = {
        "background": simulated.background,
        "images": [press.image for press in simulated.presses],
        "ball_diameters_mm": [press.ball_diameter_mm for press in simulated.presses],
        "mm_per_px": simulated.sensor.mm_per_px,
    }
    return made_once("folder", lambda path: save_press_folder(path, **content, name="simulated"))


@pytest.fixture(scope="session")
def press(sensor, made_once) -> SimulatedPress:
    """Another ball, pressed right of the middle and above it, with its truth."""
    rng = np.random.default_rng(2)
    return made_once(
        "press", lambda _: simulate_press(sensor, Ball(3.0), depth_mm=0.6, center_mm=(2.0, -1.5), rng=rng)
    )


@pytest.fixture(scope="session")
def presses(folder):
    """The folder, read."""
    return gelform.read_presses(folder)


@pytest.fixture(scope="session")
def calibration(presses, made_once):
    """A calibration made from the folder alone."""
    return made_once("calibration", lambda _: gelform.calibrate(presses))


@pytest.fixture(scope="session")
def polynomial_calibration(presses, made_once):
    """The same folder, fitted as polynomials of the color."""
    return made_once("polynomial", lambda _: gelform.calibrate(presses, color_model="polynomial"))


@pytest.fixture(scope="session")
def lambertian_calibration(presses, made_once):
    """Half of the same presses, fitted as photometric stereo."""
    half = presses.subset(range(0, len(presses.presses), 2))
    return made_once("lambertian", lambda _: gelform.calibrate(half, color_model="lambertian"))


@pytest.fixture(params=usable_isas())
def usable_isa(request) -> str:
    """Each instruction set that this processor runs: for `kernel.on(usable_isa)`."""
    return request.param


COUNT, RATE_HZ = 7, 20.0


@pytest.fixture(scope="session")
def frames(simulated):
    """Presses, one after the other."""
    start_ns = time.time_ns()
    return [
        Frame(press.image, 5.0 + k / RATE_HZ, start_ns + round(1e9 * k / RATE_HZ), k)
        for k, press in enumerate(simulated.presses[:COUNT])
    ]


@pytest.fixture(scope="session")
def forms(frames, tmp_path_factory):
    """Path by form; the video is without loss (FFV1)."""
    base = tmp_path_factory.mktemp("forms")
    recording = McapRecording(base / "a.mcap", RecordingFacts("ring", "S7", {"exposure": 50.0}, RATE_HZ))
    (base / "d").mkdir()
    for frame in frames:
        recording.write(frame)
        cv2.imwrite(str(base / "d" / f"{frame.index:03d}.png"), frame.image[..., ::-1])
    recording.close()
    video = video_file(base / "c.avi", [frame.image for frame in frames], "FFV1", RATE_HZ)
    return {"mcap": base / "a.mcap", "video": video, "images": base / "d"}


@pytest.fixture(scope="session")
def images():
    """Images of touches at several depths in an exactly known gel."""
    return [image_of(Touch(depth_mm=0.2 + 0.05 * k, seed=k)) for k in range(4)]


@pytest.fixture
def lerobot(tmp_path, images):
    """A LeRobot data set with the same touches as a video and as images in its tables; gives the folder and the frames.

    The video holds all episodes, the second table the last one.
    """
    pytest.importorskip("av", reason="the extra data is not installed")
    pytest.importorskip("pyarrow", reason="the extra data is not installed")
    root, frames = tmp_path / "set", [images[k % len(images)] for k in range(sum(EPISODES))]
    write_lerobot_set(root, frames)
    return root, frames


@pytest.fixture
def h5py():
    return pytest.importorskip("h5py", reason="the extra data is not installed")


@pytest.fixture
def zarr():
    return pytest.importorskip("zarr", minversion="3", reason="the extra data is not installed")
