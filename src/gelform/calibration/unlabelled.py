"""What presses of a ball do not label: slopes steeper than they show at a place, and the gel around contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.selection.candidates import Candidate
from gelform.color_models import DepthAwareModel, DepthByLightsModel, Samples

PLACES = 6, 8  # rows, columns
LEAST_SAMPLES = 30
STEEPEST = 0.98  # of a place's slopes are under that which is called its steepest
INNER = 0.8  # of the contact radius
# Simulated objects of eight kinds are off by two to three times what the depth's terms change of balls, which are deeper.
TIMES = 2.0
MOST = 0.5


def steepest_at_places(samples: Samples) -> tuple[tuple[float, ...], ...]:
    """Slopes that the samples reach, on a grid of places; where there are none, the least of the other places."""
    slopes = np.linalg.norm(samples.gradients, axis=1)
    known = slopes > 0
    place = np.ravel_multi_index(
        [
            np.clip((at[known] + 0.5) * count // size, 0, count - 1).astype(int)
            for at, count, size in zip((samples.y_px, samples.x_px), PLACES, samples.shape)
        ],
        PLACES,
    )
    by_place = [slopes[known][place == k] for k in range(PLACES[0] * PLACES[1])]
    whole = float(np.quantile(slopes[known], STEEPEST))
    found = [float(np.quantile(s, STEEPEST)) if len(s) >= LEAST_SAMPLES else whole for s in by_place]
    least = min(found)
    filled = [value if len(s) >= LEAST_SAMPLES else least for value, s in zip(found, by_place)]
    return tuple(tuple(row) for row in np.reshape(filled, PLACES).tolist())


def surround_sigma(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float,
    lit: DepthByLightsModel | None = None,
) -> float:
    """Relative error of how deep contacts lie, from what their surroundings may be off: nobody labels the gel there.

    The slopes that a plain model reads around contacts lack what the depth changes of the light. A model with terms of
    the depth is fitted to the same presses; by how much deeper or less deep it reads them says how large that is.

    Parameters
    ----------
    presses, contacts : prepared with the offset of `hierarchical`, and their circles
    zone : share of the contact radius that trains
    lit : the model that reads the slopes, where it corrects them for the depth: then what it may still lack counts
    """
    model = Candidate(DepthAwareModel.name, zone).fit(presses, contacts)
    assert isinstance(model, DepthAwareModel)
    shape, background = presses[0].size.shape, presses[0].background
    prepared, ratios = model.prepare(presses[0].color_change, shape), []
    known = prepared.plain_depth
    if lit is not None and background is not None:
        known = lit.prepare(background, shape).depth
    for press, contact in zip(presses, contacts):
        inside = press.pixels(contact, INNER)
        plain, aware = (read(press.color_change)[inside].mean() for read in (known, prepared.depth))
        ratios.append(aware / max(plain, 1e-6))
    return float(min(TIMES * np.sqrt(np.mean(np.square(np.array(ratios) - 1))), MOST))
