"""What a sequence adds to results; a frame that the Reconstructor refuses: nothing known, the reason said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gelform import Reconstructor
from gelform.frames import Frame
from gelform.health import DepthLimit
from gelform.streams.memory import NOT_THIS_GEL, Memory, result_from_image
from made.dots import grid, image_of_dots


def remembered(memory, images, rate_hz=25.0):
    """The results of a sequence of images."""
    results = []
    for index, image in enumerate(images):
        result = replace(memory.result_from_image(image), index=index, time_s=index / rate_hz)
        results.append(memory(image, result))
    return results


def test_frames_go_through_the_calibration_s_view(reconstruct, at_rest):
    memory = Memory(reconstruct)
    np.testing.assert_array_equal(memory.image_from_frame(Frame(at_rest[0], 0.0, 0, 0)), at_rest[0])


def test_results_of_a_short_sequence_are_the_reconstructor_s(reconstruct, pressed):
    results = remembered(Memory(reconstruct), pressed[:3])
    np.testing.assert_array_equal(results[2].depth, reconstruct.from_image(pressed[2]).depth)


def test_smoothing_is_asked_for(reconstruct, at_rest):
    plain = remembered(Memory(reconstruct), at_rest)
    smooth = remembered(Memory(reconstruct, smoothing=1.0), at_rest)
    assert smooth[-1].depth_sigma_mm.mean() < plain[-1].depth_sigma_mm.mean()
    moved = [np.abs(one[-1].depth - one[-2].depth).mean() for one in (smooth, plain)]
    assert moved[0] < 0.4 * moved[1]


def test_marker_dots_are_followed_from_frame_to_frame(calibration):
    """Over one and a half spacings, where a Reconstructor alone takes them for their neighbours."""
    shape, pitch = calibration.image_shape, 14.0
    rest = grid(pitch, shape, 12.0)
    away = np.sum(((rest - [70, 50]) / [70, 60]) ** 2, axis=1)
    drag = np.exp(-1.2 * away)[:, None] * np.array([1.5 * pitch, 0.4 * pitch])
    marked = replace(calibration, background=image_of_dots(rest, shape=shape).astype(np.float32))
    images = [image_of_dots(rest + share * drag, shape=shape) for share in np.linspace(0, 1, 12)]
    flow = remembered(Memory(Reconstructor(marked)), images)[-1].markers
    nearest = np.linalg.norm(flow.rest_px[:, None] - rest, axis=-1).argmin(axis=1)
    error = np.linalg.norm(flow.displacement_px - drag[nearest], axis=1)[flow.seen]
    assert error.max() < 1.0
    alone = Reconstructor(marked).from_image(images[-1]).markers
    assert np.linalg.norm(alone.displacement_px, axis=1).max() < pitch


@pytest.fixture
def foreign(at_rest):
    """The gel's image turned over: no gain makes one of the other."""
    return np.ascontiguousarray(at_rest[0][::-1, ::-1, [2, 0, 1]])


def test_nothing_is_known_and_the_refusal_is_a_finding(reconstruct, foreign):
    result = result_from_image(reconstruct, foreign)
    assert result.health[-1].name == NOT_THIS_GEL
    assert "background" in result.health[-1].message
    assert not result.known.any()
    assert not result.confidence.any()
    assert not result.contact.any()
    limit = DepthLimit.of(result.shape, result.mm_per_px).ignorance_mm
    assert result.depth_sigma_mm.min() == np.float32(limit)
    assert result.calibration_digest == reconstruct.calibration.digest


def test_any_other_image_passes_unchanged(reconstruct, pressed):
    result = result_from_image(reconstruct, pressed[0])
    np.testing.assert_array_equal(result.depth, reconstruct.from_image(pressed[0]).depth)


def test_an_image_of_another_size_is_refused(reconstruct, at_rest):
    with pytest.raises(ValueError, match="132"):
        result_from_image(reconstruct, at_rest[0][:-1])
