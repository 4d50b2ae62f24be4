"""The number of presses that each part of a calibration needs, with the reasons.

They count accepted presses (`circles.locate`), and frames of one press once (`circles.repeated`), except where a row says
something else. docs/press-folder.md shows the same table. A color model states the needs of its own settings (`variants`).
"""

from __future__ import annotations

from typing import NamedTuple


class Need(NamedTuple):
    """A number of presses, its purpose, and the reason that no fewer are enough."""

    presses: int
    what: str
    why: str

    def met(self, presses: int) -> bool:
        """Whether a number of presses is enough."""
        return presses >= self.presses


class _Needed(NamedTuple):
    """A row for each part, in the order of their numbers."""

    model: Need = Need(
        2, "moving circles with a color model", "a single press agrees with itself wherever its circle is"
    )
    places: Need = Need(
        3,
        "a calibration, from presses at different places",
        "each fold needs at least two others to train on",
    )
    interval: Need = Need(
        3, "the interval of a figure; a bin of the gain curve", "two presses say little about others"
    )
    spread: Need = Need(
        3, "the note that all presses lie in one part of the image", "two presses lie in one part by chance"
    )
    median: Need = Need(
        5,
        "the check for a contact in the background (images)",
        "the median of fewer images may show a contact",
    )
    guided: Need = Need(
        5, "a guided calibration on the live page (images)", "each of the five folds holds out one press"
    )
    started: Need = Need(
        5,
        "what gelform advises with a start: the starter of a make, or another unit's calibration",
        "the angle error in the contact is 2.4 degrees with 5 presses, as with 10 without a start; 1.9 with 12",
    )
    whole: Need = Need(
        6,
        "moving circles without the presses that the border cuts",
        "fewer whole presses cover too few places",
    )
    learning_curve: Need = Need(8, "a learning curve", "fewer leave no presses to hold out")
    learning_law: Need = Need(
        10,
        "a point of the curve that counts for its fitted law",
        "circles from fewer presses are too uncertain",
    )
    judged_gain: Need = Need(
        10, "a bin of the gain curve that counts for the verdict", "fewer presses may be off by chance"
    )
    fair: Need = Need(10, "the verdict fair", "fewer leave whole parts of the gel without a press")
    edge: Need = Need(
        12,
        "measuring the contact edge",
        "fewer do not show the light at every place; 0.85 of the visible radius is used instead",
    )
    size: Need = Need(
        12, "reading one ball size by the presses of another", "fewer do not show the light at every place"
    )
    advised: Need = Need(
        20,
        "what gelform advises without a start: no advice to add presses, the verdict good, the guide's message that you can "
        "fit well (images)",
        "the angle error in the contact is 4 degrees with 5 presses, 2.4 with 10, 2 with 20, 1.6 with 33",
    )
    settings: Need = Need(
        30,
        "a learning curve of the chosen settings alone",
        "with fewer presses, simpler settings may be better",
    )


NEEDED = _Needed()

SAMPLED = 24  # presses that stand for all in a median
FOLDS = 5  # groups of presses, each held out in turn: the other four fifths train

# Position degrees of the polynomial that moves uncertain circles, from a number of presses on.
REFINING = ((0, (1,)), (6, (2, 1)), (9, (3, 2, 0)))
