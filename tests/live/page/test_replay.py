"""A recording in a real browser: opened from the list, scrubbed, stepped, looped, shared, downloaded."""

import pytest

import gelform
from gelform.sensors.recordings import attached_calibration
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.indexed import indexed
from gelform.sensors.recordings.mcap_writer import McapRecording
from live_waiting import until

pytestmark = pytest.mark.slow

COUNT = 9


@pytest.fixture
def recording(simulated, tmp_path):
    """A recording of nine presses."""
    from gelform.image.frame import Frame

    written = McapRecording(tmp_path / "session.mcap", RecordingFacts("ring", "S7", {}, 10.0))
    for k, press in enumerate(simulated.presses[:COUNT]):
        written.write(Frame(press.image, k / 10, 10**18 + k, k))
    written.close()
    return tmp_path / "session.mcap"


@pytest.fixture
def replay(page, hub, recording, tmp_path):
    """The page on the recording, held."""
    hub.folder = tmp_path
    hub.recordings.add(recording)
    until(lambda: page.locator("#files .open").count() == 1)
    page.click("#files .open")
    until(lambda: page.is_visible("#replay"))
    until(lambda: page.evaluate("gelform.facts.stations[0].replay?.count") == COUNT)
    page.click("#step-back")  # holds, whether it plays or has just come to its end
    until(lambda: not hub.stations[0].source.playing)
    return page


def test_a_pressed_frame_is_no_background(replay, hub):
    replay.click("#background")
    until(lambda: "Something touches the gel" in replay.inner_text("#toasts"))
    assert hub.stations[0].setup.background is None


def number(page):
    return page.evaluate("gelform.frame?.header.replay?.[0]")


def test_it_is_scrubbed_stepped_played_and_looped(replay, hub, recording, calibration):
    seek = "(() => { const s = document.getElementById('scrub'); s.value = 4; s.dispatchEvent(new Event('input')) })()"
    replay.evaluate(seek)
    until(lambda: number(replay) == 4)
    until(lambda: replay.inner_text("#replay-at").startswith("5 / 9, 0:00.40"))
    wanted = gelform.Reconstructor(calibration)(indexed(recording).frame(4)).depth_mm
    peak = pytest.approx(wanted.max(), abs=1e-5)
    until(lambda: replay.evaluate("gelform.frame.header.peak") == peak)
    shown = f"{wanted.max():.3f}"  # no later frame draws it
    until(lambda: replay.inner_text("#number-peak .value").startswith(shown))
    replay.click("#step-back")
    until(lambda: number(replay) == 3)
    replay.keyboard.press(".")
    until(lambda: number(replay) == 4)
    replay.select_option("#speed", "8")
    replay.click("#loop")
    until(lambda: hub.stations[0].source.facts()["loop"])
    replay.click("#play")
    until(lambda: hub.stations[0].source.playing)
    until(lambda: replay.inner_text("#play") == "Pause")
    before = hub.stations[0].newest.serial
    until(lambda: hub.stations[0].newest.serial > before + COUNT, 60)  # round the end
    replay.click("#play")
    until(lambda: not hub.stations[0].source.playing)
    until(lambda: replay.inner_text("#play") == "Play")
    replay.evaluate("document.activeElement.blur()")  # a focused button takes the space
    replay.keyboard.press(" ")
    until(lambda: hub.stations[0].source.playing)


def test_one_file_is_shared_and_downloaded(replay, calibration):
    replay.click("#share")
    shared = replay.locator("#files a[title^='Download shared']")
    until(lambda: shared.count() == 1)
    with replay.expect_download() as download:
        shared.click()
    saved = download.value.path()
    fetched = saved.with_name("fetched.mcap")
    saved.rename(fetched)
    assert attached_calibration(fetched).digest == calibration.digest
    assert len(indexed(fetched)) == COUNT
    replay.click("#files-back")
    until(lambda: replay.is_hidden("#replay"))
