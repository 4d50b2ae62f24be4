"""From arguments to running stations.

A station without a calibration asks for the gel at rest; then a starter reads it, and is reported as one.

From the first frame to a calibration in use: the simulated sensor is pressed at the suggested places.
"""

import json
import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect

from gelform import CalibrationError, DataError, GelformError, load_calibration
from gelform.calibration.library import add_calibration
from gelform.calibration.starters import load_starter
from gelform.exchange.plots import save_picture
from gelform.live import actions
from gelform.live.actions import start
from gelform.live.hub import Hub
from gelform.live.lists import Calibrations
from gelform.live.station import Setup
from gelform.sensors import cameras as plugged_in
from gelform.sensors.cameras import Camera
from live_waiting import next_of, until
from made.sources import ImageSource, MjpegServer, jpeg, part


def test_without_arguments_the_simulated_sensor_is_shown_calibrated():
    with closing(start(rate_hz=30)) as hub:
        shown = until(lambda: hub.stations[0].newest)
        assert shown.image.shape == (240, 320, 3)
        until(lambda: hub.stations[0].newest.result is not None)


@pytest.mark.parametrize(
    ("sources", "calibrations", "error", "said"),
    [
        (["simulated"] * 3, ["a.npz", "b.npz"], DataError, "one for each of the 3"),
        (["simulated"], ["missing.npz"], CalibrationError, r"missing\.npz"),
        (["simulated:three-edge"], [], ValueError, "three-edges"),
        (["nowhere/none.mp4"], [], DataError, r"none\.mp4"),
        (["seq"], [], DataError, r"No camera, file or folder seq\. Check the path"),
        (["D1", "D1"], [], DataError, "'D1' twice"),
        (["D1", "simulated", "DIGIT"], [], DataError, "'D1' and 'DIGIT', which is one camera"),
        (["http://127.0.0.1:9/a"] * 2, [], DataError, "'http://127.0.0.1:9/a' twice"),
        (["NO-SUCH-SERIAL-7"] * 2, [], DataError, "'NO-SUCH-SERIAL-7' twice"),
    ],
)
def test_mistakes_are_said_at_once(tmp_path, sources, calibrations, error, said, monkeypatch):
    monkeypatch.setattr(plugged_in, "cameras_there", lambda: [Camera("DIGIT", "/dev/video0", "D1")])
    with pytest.raises(error, match=said):
        start(sources, [tmp_path / name for name in calibrations])


def test_a_camera_that_is_not_there_is_said_and_waited_for_also_without_a_library(monkeypatch):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", "relative")
    with closing(start(["NO-SUCH-SERIAL-7"])) as hub:
        assert "Expected an absolute path in GELFORM_CALIBRATIONS" in hub.notices[0][2]
        assert "tries again" in hub.notices[1][2]
        until(lambda: hub.stations[0].facts()["reason"])
        assert hub.stations[0].facts()["state"] == "missing"


def test_the_password_of_a_camera_is_shown_nowhere():
    with MjpegServer([part(jpeg()), 0.1] * 40) as server:
        spec = server.url.replace("//", "//eve:hidden@")
        with closing(start([spec])) as hub:
            until(lambda: hub.stations[0].newest)
            facts = [hub.facts()]
        until(lambda: server.requests)
        assert b"Basic" in server.requests[0]
    with closing(start([spec])) as hub:  # nothing answers any more
        until(lambda: hub.stations[0].facts()["reason"])
        facts.append(hub.facts())
    for one in facts:
        assert one["stations"][0]["spec"] == server.url
        assert "hidden" not in json.dumps(one)
    with pytest.raises(DataError, match="twice") as refused:
        start([spec, spec])
    assert "hidden" not in str(refused.value)


def test_a_folder_waits_for_the_first_page_plays_once_and_stays_at_its_end(tmp_path, simulated, calibration):
    for k, press in enumerate(simulated.presses[:4]):
        save_picture(tmp_path / f"{k}.png", press.image)
    calibration.save(tmp_path / "mine.npz")
    with closing(start([str(tmp_path)], [tmp_path / "mine.npz"])) as hub:
        station = hub.stations[0]
        until(lambda: station.newest)
        time.sleep(0.4)  # ten frames
        assert station.player.facts()["number"] == 0
        hub.sinks += 1  # as a page
        until(lambda: (r := station.facts()["replay"]) and not r["playing"] and r["number"] == 3)
        until(lambda: station.newest.frame.number == 3 and station.newest.result)
        assert station.facts()["state"] == "running"  # held, not lost
        assert hub.recordings.facts()[0]["name"] == tmp_path.name


def test_a_folder_of_blue_green_red_frames_is_shown_in_rgb_and_has_its_controls(tmp_path, simulated):
    image = simulated.presses[0].image
    for k in range(2):
        save_picture(tmp_path / f"{k}.png", image[..., ::-1])
    with closing(start([str(tmp_path)], bgr=True)) as hub:
        (station,) = hub.stations
        until(lambda: station.player)
        station.pause(True)
        assert not station.player.playing
        station.player.seek(1)
        until(lambda: (one := station.newest) and one.frame.number == 1)
        np.testing.assert_array_equal(station.newest.frame.image, image)


def test_bgr_holds_for_recordings_that_are_opened_later_and_not_for_the_pages_own(tmp_path, simulated):
    """A stack of images states no order of its channels; a recording of the page does."""
    image = simulated.presses[0].image
    given, later = tmp_path / "given.npy", tmp_path / "later.npy"
    for path in (given, later):
        np.save(path, np.stack([image[..., ::-1]] * 2))
    with closing(start([str(given)], folder=tmp_path, bgr=True)) as hub:
        (station,) = hub.stations
        until(lambda: station.player)
        actions.share(hub, station)
        shared = until(lambda: next(tmp_path.glob("shared*.mcap"), None))
        for path in (later, shared):
            actions.open_recording(hub, station, hub.recordings.add(path))
            until(lambda path=path: station.player and station.player.recording.path == path)
            np.testing.assert_array_equal(station.player.recording[1].image, image)


@pytest.mark.slow
def test_two_simulated_sensors_are_touched_apart_from_each_other():
    with closing(start(["simulated", "simulated"], rate_hz=20)) as hub:
        until(lambda: all(station.newest and station.newest.result for station in hub.stations))
        first, second = (station.source for station in hub.stations)
        assert (first.image_at(7) != second.image_at(7)).mean() > 0.2
        assert hub.calibrations.names == ["simulated sensor three-edges"]


def test_a_camera_that_another_program_has_is_said_with_its_name(tmp_path, monkeypatch):
    """A file below /dev that another process holds stands for the camera: OpenCV gets no picture from it either."""
    shared = Path("/dev/shm")
    if not sys.platform.startswith("linux") or not shared.is_dir():
        pytest.skip("needs Linux with /dev/shm")
    # The kernel knows that it is a file.
    monkeypatch.setattr(plugged_in, "_is_video_device", lambda path: True)
    camera = shared / f"gelform-test-{tmp_path.name}"
    camera.write_bytes(b"")
    with camera.open("rb") as held, subprocess.Popen(["sleep", "60"], stdin=held) as other:
        try:
            hub = start([str(camera)])
            hub.close()
            assert f"in use by sleep (process {other.pid})" in hub.notices[0][2]
            assert "Close the other program" in hub.notices[0][2]
        finally:
            other.kill()
            camera.unlink()


@pytest.mark.slow
def test_what_calibrates_is_imported_when_it_is_needed():
    """It takes as long as the first picture."""
    loaded = "import sys, gelform.live.actions, gelform.live.web.app; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    light = ("gelform.calibration.library", "gelform.calibration.starters")
    heavy = [one for one in run.stdout.split() if one.startswith(("gelform.calibration.", "scipy.optimize"))]
    assert not [name for name in heavy if not name.startswith(light)]


def test_the_newest_calibration_of_the_camera_is_taken_from_the_library(library, calibration, monkeypatch):
    """A camera that is not there yet is known by the serial that it is called by."""
    for serial, gel in (("D1", "1"), ("D1", "2"), ("D2", "3")):
        made = replace(calibration, serial=serial, gel_id=gel, created_utc=f"2026-11-0{gel}T00:00:00+00:00")
        add_calibration(made)
    (library / "damaged.npz").write_text("none")
    with closing(start(["D1"])) as hub:
        assert hub.stations[0].setup.calibration.gel_id == "2"
        assert "(gel 2, of 2026-11-02 00:00)" in hub.notices[-1][2]
        assert len(hub.calibrations.names) == 3


def words_until(socket, wanted):
    """The first facts of the page of which something is wanted."""
    return next_of(socket, lambda data: isinstance(data, str) and wanted(json.loads(data)))


@contextmanager
def live_running(folder):
    """`gelform live` in a process of its own, spoken to as the page does."""
    command = [sys.executable, "-m", "gelform", "live", "simulated", "--folder", folder, "--rate", "30"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        try:
            url = running.stdout.readline().strip()
            address, origin = url.replace("http", "ws") + "ws", url.rstrip("/")
            with connect(address, origin=origin, compression=None, max_size=None, proxy=None) as socket:
                yield socket
        finally:
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=20)


@pytest.mark.slow
def test_what_the_guide_saves_is_in_use_after_a_restart_without_a_flag(library, tmp_path):
    def used(facts):
        """The name of the calibration, once there are pictures."""
        (station,) = facts.get("stations") or [{}]
        return station.get("rate_hz") and station["calibration"]

    def guide(facts):
        return (facts.get("guides") or {}).get("0", {})

    with live_running(tmp_path / "first") as socket:
        assert words_until(socket, used) == "simulated sensor three-edges"
        ask = {"do": "guide_start", "station": 0, "ball_diameter_mm": 5.0, "profile": "", "mm_per_px": 0.0}
        socket.send(json.dumps(ask))
        words_until(socket, lambda facts: guide(facts).get("can_fit"))
        socket.send(json.dumps({"do": "guide_fit", "station": 0}))
        words_until(socket, lambda facts: guide(facts).get("step") == "report")
        assert not list(library.glob("*")), "only when it is used"
        socket.send(json.dumps({"do": "guide_use", "station": 0}))
        kept = words_until(socket, lambda facts: (name := used(facts)) and name.endswith(".npz") and name)
    assert [path.name for path in library.iterdir()] == [kept]
    with live_running(tmp_path / "second") as socket:
        assert words_until(socket, used) == kept
    assert load_calibration(library / kept).serial == "simulated-three-edges"


MAKE = "simulated-three-edges"


@pytest.fixture
def never(unpressed, show):
    """A hub whose one station is a camera that was never calibrated; its source's images are what it shows."""
    hub, source = Hub(), ImageSource(unpressed[0.0], rate_hz=40)
    source.serial = "S1"
    show(lambda: source, hub)
    return hub


def let_see(station, images):
    """Let the camera see something else, and wait until the images that were on their way are through."""
    station.source.images, after = images, station.newest.serial + 4
    until(lambda: station.newest.serial >= after)


def said(hub):
    return hub.facts()["stations"][0]["starter"]


def test_the_untouched_gel_is_asked_for_and_depth_follows(never, unpressed):
    (station,) = never.stations
    assert said(never) == {"state": "ask", "sensor": "", "make": "", "said": []}
    with pytest.raises(GelformError, match="Choose the sensor in the list"):
        actions.take_starter(never, station, "")
    station.sensor = MAKE
    assert said(never)["sensor"] == said(never)["make"] == MAKE
    actions.take_starter(never, station, "")
    let_see(station, unpressed[0.4])
    until(lambda: station.newest.numbers and station.newest.numbers.peak > 0.3)
    assert said(never)["state"] == "used"
    assert said(never)["percent"] == pytest.approx(100 * load_starter(MAKE).spread)
    assert "starter" in [name for name, *_ in station.newest.header()["health"]]
    assert station.setup.calibration.serial == "S1"
    assert never.calibrations.names == [station.setup.name]
    actions.guide_start(never, station, 5.0, MAKE, 0.5)
    known = never.guides[0].guide.settings
    assert known.mm_per_px == load_starter(MAKE).calibration.mm_per_px, "the starter's"
    assert (known.name, known.serial) == (MAKE, "S1")


def test_something_that_moves_is_said_and_it_is_taken_again(never, unpressed):
    (station,) = never.stations
    let_see(station, [one for both in zip(unpressed[0.0], unpressed[0.4]) for one in both])
    actions.take_starter(never, station, MAKE)
    assert said(never)["state"] == "ask"
    assert "Something moves" in said(never)["said"][0]
    let_see(station, unpressed[0.0])
    actions.take_starter(never, station, MAKE)
    assert said(never)["said"] == []
    first = replace(station.setup.calibration, mm_per_px=0.06)  # the user's own scale, which stays
    station.setup = Setup(first, station.setup.name)
    let_see(station, [image // 2 for image in unpressed[0.0]])
    actions.take_background(never, station)  # its lamps are half as bright: the starter is brought to them
    assert station.setup.calibration.background.mean() < 0.6 * first.background.mean()
    assert station.setup.calibration.mm_per_px == 0.06
    assert len(never.calibrations.names) == 1
    actions.undo_background(never, station)
    assert station.setup.calibration is first is never.calibrations[station.setup.name]


def test_another_make_is_refused_with_the_reason_and_a_pressed_gel_is_said(never, unpressed):
    (station,) = never.stations
    for make, sees, words in (
        ("digit", 0.0, "background of a DIGIT"),
        ("gelsight-mini", 0.0, "background of a GelSight Mini"),
        (MAKE, 0.4, "Something seems to touch the gel"),
    ):
        let_see(station, unpressed[sees])
        actions.take_starter(never, station, make)
        assert said(never)["state"] == ("used" if make == MAKE else "ask")
        assert words in said(never)["said"][0]


def test_a_scratched_gel_is_said_beside_the_depth(never, unpressed):
    scratched = np.array(unpressed[0.0])
    scratched[:, 100:112] //= 8
    let_see(never.stations[0], list(scratched))
    actions.take_starter(never, never.stations[0], MAKE)
    assert any("scratched" in one for one in said(never)["said"])


def test_a_make_that_was_named_is_asked_for_instead_of_calibrated():
    with closing(start(rate_hz=30, sensor=MAKE)) as hub:
        (station,) = hub.stations
        assert not hub.work
        assert said(hub)["sensor"] == MAKE
        until(lambda: station.newest)
        actions.take_starter(hub, station, "")  # the simulated sensor rests meanwhile
        assert said(hub)["state"] == "used"
        until(lambda: station.newest.result)


@pytest.fixture
def guide(hub, station, tmp_path):
    """The guide of the hub's station, begun."""
    hub.folder = tmp_path
    actions.guide_start(hub, station, 5.0, "", 0.0)
    return hub.guides[0].guide


@pytest.fixture
def fits(guide, presses, calibration, monkeypatch):
    """The guide, which fits the calibration of the sensor whatever was pressed."""
    monkeypatch.setattr(guide, "presses", lambda: presses)
    monkeypatch.setattr("gelform.calibration.guide.calibrate", lambda *_, **__: calibration)
    return guide


def test_a_press_is_made_where_the_guide_asks_and_counts(hub, station, guide):
    until(lambda: guide.target)
    x, y = guide.target.x_px, guide.target.y_px
    until(lambda: guide.count >= 1)
    assert guide.facts()["accepted"][0][:2] == pytest.approx((x, y), abs=4)
    hub.end_guide(station)
    assert not hub.guides
    assert not station.taps


def test_what_was_fitted_is_reported_and_used(hub, station, library, fits, calibration):
    with pytest.raises(GelformError, match="no calibration to use"):
        actions.guide_use(hub, station)
    fits.fit(hub.folder)
    assert fits.step == "report"
    assert fits.facts()["report"]["folder"] == fits.made.folder.name
    assert not list(library.glob("*"))
    actions.guide_use(hub, station)
    assert station.setup.calibration.digest == calibration.digest
    (kept,) = library.iterdir()
    assert station.setup.name == kept.name
    assert "The library has it too" in hub.notices[-1][2]


def test_what_is_not_used_is_used_nowhere(hub, station, library, fits):
    before, listed = station.setup, hub.calibrations.names
    fits.fit(hub.folder)
    folder = fits.made.folder
    actions.guide_stop(hub, station)
    assert not hub.guides
    assert not list(library.glob("*"))
    assert station.setup is before
    assert hub.calibrations.names == listed
    assert Calibrations(folder=hub.folder, library=library).names == [], "nor after a restart"
    assert folder.name in hub.notices[-1][2]
    assert (folder / "presses.csv").exists()


@pytest.mark.slow
def test_after_the_report_more_presses_are_made_at_its_places(hub, station, fits):
    until(lambda: fits.step == "press")
    with pytest.raises(GelformError, match="no report yet"):
        actions.guide_more(hub, station)
    fits.wanted = 0
    fits.fit(hub.folder)
    count, marked = fits.count, fits.places
    assert marked == fits.made.places
    actions.guide_more(hub, station)
    assert (fits.step, fits.made, fits.places) == ("press", None, marked)
    assert fits.wanted == count + len(marked)
    with pytest.raises(GelformError, match="Press Fit now first"):
        actions.guide_use(hub, station)
    until(lambda: fits.count > count)
    assert fits.facts()["accepted"][count][:2] == pytest.approx((marked[0].x_px, marked[0].y_px), abs=4)


def test_a_fit_that_does_not_succeed_asks_for_more(hub, guide):
    with pytest.raises(GelformError):
        guide.fit(hub.folder)
    assert guide.step == "background"
    until(lambda: guide.step == "press")
