"""The same frames give the same background, the same doubt and the same sentence, whichever command takes them."""

from __future__ import annotations

from itertools import cycle, islice
from types import SimpleNamespace

import numpy as np
import pytest

from gelform import Frame, GelformError, Reconstructor, background_from_frames
from gelform.batch.inputs import background_of_film, listing_of, plan_of
from gelform.calibration.guide import Guide, TakenPresses
from gelform.calibration.starters import load_starter
from gelform.cli.commands import sources
from gelform.foundations.files import picture_bytes
from gelform.image.background import USUAL_FRAMES
from gelform.live import actions
from gelform.live.station import Setup
from gelform.sensors import SensorSettings, read_background
from gelform.sensors.profiles import SENSORS
from gelform.sensors.streams.memory import Memory
from gelform.sensors.streams.stream import UntouchedImage
from gelform.simulate import Ball, simulate_background, simulate_press

MINI = "gelsight-mini"


def frames_of(images):
    """Frames of a camera with 15 Hz."""
    return [Frame(image, k / 15, k, k) for k, image in enumerate(images)]


def of_function(images, calibration, folder):
    taken = background_from_frames(images, untouched=calibration.background)
    return taken.background, taken.findings


def of_page(images, calibration, folder):
    """The live page's button; it keeps whole gray levels, for recordings."""
    said = []
    shown = [SimpleNamespace(image=image) for image in images]
    station = SimpleNamespace(
        simulated=None, setup=Setup(calibration, "own"), next_frames=lambda count: shown
    )
    actions.take_background(SimpleNamespace(notice=said.append), station)
    return station.setup.background, said


def of_stream(images, calibration, folder):
    """A stream's, and with it the ROS service's; a touched one is asked for twice."""
    memory = Memory(Reconstructor(calibration))
    said = []
    for start in (0.0, 2.0):
        memory.take_background()
        for frame in frames_of([*images, images[0]]):  # the last one ends the second
            frame = Frame(frame.image, start + frame.time_s, 0, frame.index)
            memory.learn_from(memory.reconstructed(frame))
        assert not memory.background_request[0]
        said += memory.background_request[1]
        if not any("ask once more" in one.message for one in said):
            break
    if said and said[-1].name == "background_refused":
        raise GelformError(said[-1].message)
    return memory.reconstruct.background, [*said, *memory.reconstruct.findings]


def of_files(images, calibration, folder):
    """`--background` with a folder, in each command that reads one."""
    background = read_background(folder)
    return background, Reconstructor(calibration, background).findings


def of_batch(images, calibration, folder):
    """`--background-frames`."""
    (part,) = plan_of(listing_of(folder), len(images), len(images))
    background = background_of_film(part, len(images), calibration)
    return background, Reconstructor(calibration, background).findings


TAKERS = (of_page, of_stream, of_files, of_batch)


@pytest.fixture
def images_of(sensor):
    rng = np.random.default_rng(4)
    rest = [np.asarray(simulate_background(sensor, rng)) for _ in range(USUAL_FRAMES)]
    ball = simulate_press(sensor, Ball(2.5), depth_mm=0.5, rng=None).image.astype(np.float32)
    touched = [
        np.clip(ball + np.float32(one) - simulate_background(sensor, None), 0, 255).astype(np.uint8)
        for one in rest
    ]
    return {
        "at rest": rest,
        "darker": [(0.95 * one).astype(np.uint8) for one in rest],
        "touched": touched,
        "passing": [*touched[:3], *rest[3:]],
        "moving": [np.roll(one, 25 * (k % 4), axis=1) for k, one in enumerate(touched)],
        "mirrored": [np.ascontiguousarray(one[:, ::-1]) for one in rest],
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "doubt"),
    [
        ("at rest", ""),
        ("darker", "The exposure differs from the calibration's by R"),
        ("touched", "Something seems to touch the gel"),
        ("passing", ""),
        ("moving", "Expected frames of the gel at rest that agree, got 1[0-5] of 15"),
        ("mirrored", "The image is mirrored left to right compared with the background"),
    ],
)
def test_takers_with_a_calibration_agree(kind, doubt, images_of, calibration, tmp_path):
    images = images_of[kind]
    for k, image in enumerate(images):
        (tmp_path / f"{k:02d}.png").write_bytes(picture_bytes(image))
    if kind in ("moving", "mirrored"):
        for taker in (of_function, *TAKERS):
            with pytest.raises(GelformError, match=doubt):
                taker(images, calibration, tmp_path)
        return
    background, found = of_function(images, calibration, tmp_path)
    assert [doubt in one.message for one in found] == [True] * bool(doubt)
    for taker in TAKERS:
        taken, said = taker(images, calibration, tmp_path)
        whole = np.rint if taker is of_page else np.asarray
        np.testing.assert_array_equal(taken, whole(background), err_msg=taker.__name__)
        texts = [one if isinstance(one, str) else one.message for one in said]
        for one in found:
            if taker is not of_page or one.name == "background_touched":
                assert any(one.message in text for text in texts), taker.__name__
        assert any("Something seems to touch" in text for text in texts) == (kind == "touched")


@pytest.mark.slow
@pytest.mark.parametrize("touched", [False, True])
def test_takers_of_a_make_with_a_starter_agree(touched, monkeypatch, capsys, tmp_path):
    starter, layout, rng = load_starter(MINI), SENSORS[MINI].simulated(), np.random.default_rng(6)
    image = starter.calibration.background  # as smooth as its light
    if touched:
        pressed = simulate_press(layout, Ball(2.5), depth_mm=0.4, center_mm=(2, 1), rng=None).image
        image = image + pressed.astype(np.float32) - simulate_background(layout, None)
    noisy = [image + rng.normal(0, 1, image.shape) for _ in range(USUAL_FRAMES)]
    images = [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy]
    taken = background_from_frames(images, smooth=True)
    doubt = taken.touch.message if touched else ""
    assert ("Something seems to touch the gel" in doubt) == touched == bool(taken.findings)

    guide = Guide(SensorSettings("my Mini", layout.mm_per_px, make=MINI), 4.0)
    for k in range(6):
        for one in images:
            guide._add_untouched(one)
        assert (guide.step == "background") == (touched and k < 5)
        assert doubt in guide.hint or k == 5
        if not touched:
            break
    np.testing.assert_array_equal(guide._background, np.rint(taken.background))

    monkeypatch.setattr(sources, "_fresh", lambda grabber, count: list(islice(cycle(images), count)))
    keys = iter("   ")
    of_record = TakenPresses(tmp_path / "p", SensorSettings("my Mini", layout.mm_per_px, make=MINI), 4.0)
    assert sources._at_rest(None, lambda: next(keys), of_record, viewed=False)
    assert len(list(keys)) == 2 - touched, "asked again once"
    assert " ".join(doubt.split()) in " ".join(capsys.readouterr().err.split())
    np.testing.assert_array_equal(read_background(tmp_path / "p" / "background"), taken.background)

    of_stream = UntouchedImage(starter)
    for frame in frames_of(images):
        of_stream.keep(frame)
    mean = of_stream.mean()
    np.testing.assert_array_equal(mean, taken.background)
    assert [one.message for one in starter.for_unit(mean).findings if one.name == "background_touched"] == (
        [doubt] * touched
    )


@pytest.mark.slow
def test_a_background_that_is_taken_clean_clears_what_was_said_of_the_one_before(images_of, calibration):
    rest, touched = images_of["at rest"], images_of["touched"]
    memory = Memory(Reconstructor(calibration, np.mean(touched, axis=0, dtype=np.float32)))
    assert "background_touched" in {one.name for one in memory.reconstruct.findings}
    memory.take_background()
    for frame in frames_of([*rest, rest[0]]):
        memory.learn_from(memory.reconstructed(frame))
    assert memory.reconstruct.findings == calibration.findings
