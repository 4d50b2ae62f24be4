"""gelform cameras and gelform record: connected cameras, frames into files, presses taken with the space bar.

gelform live: the address is printed; tests/live tests the page.
"""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.request
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.calibration.guide import TakenPresses
from gelform.calibration.presses.folder import read_presses
from gelform.calibration.starters import load_starter
from gelform.calibration_file import load_calibration
from gelform.cli.commands.sources import _at_rest, single_keys
from gelform.image.view import image_from_frame
from gelform.sensors import cameras as camera
from gelform.sensors.cameras import Camera
from gelform.sensors.files import SensorSettings, read_background, read_image, read_sensor_toml
from gelform.sensors.films import open_film
from gelform.sensors.grabber import Grabber
from gelform.sensors.mcap import end_missing
from gelform.sensors.record import RecordStats, why_missing
from gelform.sensors.source import open_source
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press
from live_waiting import until
from made.sources import Capture, ImageSource, MjpegServer, jpeg, part
from made.sources import camera as frames_of

termios = pytest.importorskip("termios", reason="no POSIX terminal here")


@pytest.fixture
def keyboard(monkeypatch):
    keys, terminal = os.openpty()
    with os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield keys
    os.close(keys)


def test_keys_come_without_enter_and_the_terminal_is_as_before(keyboard):
    before = termios.tcgetattr(sys.stdin)
    with single_keys("this") as key:
        os.write(keyboard, b" q")
        assert [key(), key()] == [" ", "q"]
    assert termios.tcgetattr(sys.stdin) == before
    with pytest.raises(RuntimeError), single_keys("this"):
        raise RuntimeError
    assert termios.tcgetattr(sys.stdin) == before


@pytest.fixture
def plugged_in(monkeypatch):
    return lambda *cameras: monkeypatch.setattr(camera, "cameras_there", lambda: list(cameras))


def test_nothing_there_says_what_to_do(works, run_json, plugged_in):
    plugged_in()
    out, err = works("cameras")
    assert out == ""
    assert re.search("Plug one in.*simulated", err, re.S)
    assert run_json("cameras") == {"cameras": []}


def test_a_camera_with_its_measured_rate(run, run_json, plugged_in, monkeypatch, tmp_path):
    path = tmp_path / "video0"
    path.write_text("")
    plugged_in(Camera("DIGIT", str(path), "D1", "2833:0209", "/dev/v4l/by-path/p4", "digit"))
    monkeypatch.setattr(camera, "_opened", lambda _: Capture([np.zeros((240, 320, 3), np.uint8)] * 1000))
    monkeypatch.setattr("gelform.cli.commands.sources.MEASURED_S", 0.02)
    (found,) = run_json("cameras")["cameras"]
    assert (found["serial"], found["sensor"], found["problem"]) == ("D1", "digit", None)
    assert found["rate_hz"] > 0
    assert found["settings"]["fps"] == 60.0
    out = run("cameras")[1]
    assert all(said in out for said in ("DIGIT", "D1", str(path)))


def test_a_camera_that_gives_nothing(run_json, plugged_in, monkeypatch):
    plugged_in(Camera("a camera", "/dev/none", "S1"))
    monkeypatch.setattr(camera, "UsbCamera", lambda _: frames_of(0)())
    monkeypatch.setattr("gelform.cli.commands.sources.FIRST_S", 0.05)
    (found,) = run_json("cameras")["cameras"]
    assert (found["problem"], found["settings"]) == ("it opens, but gives no frame", {"gain": 3.0})
    monkeypatch.setattr(camera, "UsbCamera", lambda _: pytest.fail("opened"))
    (found,) = run_json("cameras", "--no-measure")["cameras"]
    assert (found["rate_hz"], found["problem"]) == (None, None)


def test_what_cannot_be_opened_says_why_and_the_others_are_listed(works, run_json, plugged_in, tmp_path):
    gone = Camera("DIGIT", str(tmp_path / "video0"), "D1")
    plugged_in(gone, Camera("GelSight", str(tmp_path / "video2"), "S1"))
    out, err = works("cameras")
    assert "GelSight" in out
    assert err.count("unplugged") == 2


def jpeg_of(image):
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()


def sent(picture, rate_hz=100.0):
    """Parts without end of what `picture()` is at the moment."""
    while True:
        yield part(picture())
        yield 1 / rate_hz


def test_into_mcap_with_the_calibrations_digest(works, tmp_path, calibration_file):
    path = tmp_path / "r.mcap"
    with MjpegServer(sent(jpeg)) as server:
        err = works("record", server.url, "-o", path, "--seconds", "0.2", "-c", calibration_file)[1]
    assert end_missing(path) == ""
    film = open_film(path)
    assert film.camera.calibration_digest == load_calibration(calibration_file).digest
    assert f"{len(film.times_s)} frames" in err
    taken = list(open_source(path))
    assert len(taken) == len(film.times_s) > 0
    assert taken[0].encoded == jpeg()


@pytest.mark.slow
def test_ctrl_c_is_the_usual_end(tmp_path):
    path = tmp_path / "r.mcap"
    with MjpegServer(sent(jpeg)) as server:
        command = [sys.executable, "-m", "gelform", "record", server.url, "-o", str(path), "--json"]
        recorder = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            until(lambda: path.is_file() and path.stat().st_size > 3 * len(jpeg()))
            recorder.send_signal(signal.SIGINT)
            out, err = recorder.communicate(timeout=30)
        finally:
            recorder.kill()
    assert recorder.returncode == 0, err
    assert json.loads(out)["frames"] == len(list(open_source(path)))


def test_presses_with_the_space_bar(works, tmp_path, press_folder, monkeypatch):
    """Keys come through a real terminal, pictures from a real server: background, two presses, one taken out."""
    given = read_presses(press_folder)
    rest = read_image(press_folder / "background.png")
    pressed = [jpeg_of(press.image) for press in given.presses[:2]]
    showing = [jpeg_of(rest)]
    folder = tmp_path / "taken"

    def hand():
        try:
            until((folder / "sensor.toml").exists)
            os.write(keyboard, b" ")
            until((folder / "background" / "09.png").exists)
            for k, picture in enumerate((pressed[0], pressed[1], pressed[1])):
                showing[0], before = picture, len(counted)
                until(lambda before=before: len(counted) > before + 30)
                os.write(keyboard, b" ")
                until((folder / "images" / f"000{k}.png").exists)
            os.write(keyboard, b"u")
            until(lambda: not (folder / "images" / "0002.png").exists())
        finally:
            os.write(keyboard, b"q")

    counted = []

    def picture_now():
        counted.append(1)
        return showing[0]

    keyboard, terminal = os.openpty()
    hands = threading.Thread(target=hand)
    with MjpegServer(sent(picture_now)) as server, os.fdopen(terminal) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        hands.start()
        how = ("--presses", "--ball-diameter-mm", "6", "--mm-per-px", "0.1268", "--sensor", "gelsight-mini")
        err = works("record", server.url, "-o", folder, *how)[1]
        hands.join()
    os.close(keyboard)
    assert f"gelform calibrate {folder}" in err
    taken = read_presses(folder)
    assert [press.ball_diameter_mm for press in taken.presses] == [6.0, 6.0]
    for mine, theirs in zip(taken.presses, given.presses):
        assert np.abs(mine.image.astype(float) - image_from_frame(theirs.image, taken.view)).mean() < 2
    assert np.abs(taken.background - image_from_frame(rest, taken.view)).mean() < 2
    assert taken.view.frame_shape == rest.shape[:2]
    assert taken.camera == {"width": 160, "height": 120, "reduced": 1}
    settings = read_sensor_toml(folder / "sensor.toml")
    assert (settings.mm_per_px, settings.make) == (0.1268, "gelsight-mini")


def test_no_terminal_is_said_and_no_file_is_left(fails, monkeypatch, tmp_path):
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
    how = ("simulated", "-o", tmp_path / "r", "--presses", "--ball-diameter-mm", "6")
    assert "--presses takes keys from a terminal, and standard input is none" in fails("record", *how)
    assert not (tmp_path / "r").exists()


def test_a_background_is_taken_again_if_it_is_touched_or_moves_and_a_dark_surround_is_named(
    capsys, monkeypatch, tmp_path
):
    """Touched once, of a make with a starter: the second space bar takes what is there; frames that move never."""
    known = {"simulated-three-edges": load_starter("simulated-three-edges")}
    monkeypatch.setattr("gelform.calibration.guide.starter_for", lambda make, _: known.get(make))
    layout, rng = LAYOUTS["three-edges"], np.random.default_rng(2)
    touched = np.asarray(simulate_press(layout, Ball(2.5), depth_mm=0.5, rng=rng).image)
    rest = np.asarray(simulate_background(layout, rng))
    framed = np.pad(rest, ((0, 0), (40, 0), (0, 0)), constant_values=2)
    moving = [np.roll(touched, 20 * k, axis=1) for k in range(4)]
    settings = SensorSettings("small", layout.mm_per_px)
    for make, first, keys, taken, said in (
        ("simulated-three-edges", [touched], "  ", touched, "Something seems to touch the gel"),
        ("simulated-three-edges", [touched], " q", None, "Something seems to touch the gel"),
        ("simulated-three-edges", [rest], " ", rest, "^$"),
        ("another", [touched], " ", touched, "^$"),
        ("another", [framed], " ", framed, r"outside the gel.* --crop 4\d,0,\d+,\d+"),
        (
            "another",
            moving,
            "  q",
            None,
            "Not taken. Expected frames .* that agree, .* space bar again. Not taken",
        ),
    ):
        source, keyboard = ImageSource(first, rate_hz=100), iter(keys)
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        presses = TakenPresses(folder, replace(settings, make=make), 6.0)
        with Grabber(lambda source=source: source) as grabber:
            at_rest = _at_rest(grabber, lambda keyboard=keyboard: next(keyboard), presses, viewed=False)
        assert at_rest == (taken is not None)
        assert not list(keyboard)
        if at_rest:
            np.testing.assert_array_equal(read_background(folder / "background"), taken)
        assert re.search(said, " ".join(capsys.readouterr().err.split()))


def test_why_frames_are_missing_is_said_and_is_a_warning_over_5_percent():
    stats = RecordStats(frames=91, missing=9, written_bytes=1, duration_s=3.0)
    said = why_missing(stats, 4)
    assert stats.has_gaps
    assert said.startswith("9 of 100 frames (9 %) are missing: 4 lost before gelform got them")
    assert " and 5 not written, because this machine or its disk was too slow. 30 frames a second" in said
    assert not RecordStats(99, 1, 1, 3.0).has_gaps
    few = why_missing(RecordStats(99, 1, 1, 3.0), 7)
    assert few.startswith("1 of 100 frames (1 %) are missing: 1 lost before gelform")
    assert "too slow" not in few


@pytest.mark.slow
def test_it_prints_an_address_that_answers_and_ends_on_interrupt():
    command = [sys.executable, "-m", "gelform", "live"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            url = running.stdout.readline().strip()
            assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", url)
            with urllib.request.urlopen(url, timeout=20) as answer:
                assert b"<title>gelform live</title>" in answer.read()
        finally:
            os.kill(running.pid, signal.SIGINT)
        _, said = running.communicate(timeout=20)
    assert "Traceback" not in said
    assert running.returncode in (0, 130)
