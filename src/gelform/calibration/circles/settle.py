"""The last moves of the circles that train: to agree with a stiff hierarchical model of all of them.

The polynomials that circles are refined with have few terms and are wrong in places, and circles move after them. A
hierarchical model with a strong ridge is less wrong there, and too stiff to follow a single circle that is off.
"""

from __future__ import annotations

from collections.abc import Sequence

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.refine import REFINING_ZONE, recentered
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.color_models import HierarchicalModel

ROUNDS = 2
RIDGE = 1e-2
SAMPLES = 8_000
LEAST_PRESSES = 9


def settled(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], found: Sequence[ContactCircle]
) -> tuple[ContactCircle, ...]:
    """The contacts of presses that fit, moved to where their balls agree best with one model of all.

    Of fewer than 9 presses they stay: these say too little of most places.

    Parameters
    ----------
    presses, contacts : that train, and their refined circles
    found : the circle found in each image, from which none moves far
    """
    if len(presses) >= LEAST_PRESSES:
        for _ in range(ROUNDS):
            samples = contact_samples(presses, contacts, REFINING_ZONE, total=SAMPLES)
            model = HierarchicalModel.fit(with_rest_samples(samples, presses, contacts), ridge=RIDGE)
            contacts = [recentered(*own, model) for own in zip(presses, contacts, found)]
    return tuple(contacts)
